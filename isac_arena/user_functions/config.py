"""Settings of functions of a user: which function takes the place of a stage, and with what keyword arguments."""

import json
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, Field, JsonValue

from isac_arena.user_functions.names import OURS, FunctionName
from scenes.toml_config import ConfigModel

Stage = Literal["channel", "mapping", "slam", "shapes", "tracker"]
STAGES: tuple[Stage, ...] = get_args(Stage)
CALL_LIMIT_S = 3600.0  # of a call: a function that takes longer is taken as one that hangs
M = TypeVar("M", bound=BaseModel)


def _usable(settings: dict[str, JsonValue]) -> dict[str, JsonValue]:
    wrong = [name for name in settings if not name.isidentifier()]
    if wrong:
        raise ValueError(f"'{wrong[0]}' is no name of an argument")
    try:
        json.dumps(settings, allow_nan=False)
    except (ValueError, RecursionError):
        raise ValueError("every number must be finite, and tables may not be nested too deep") from None
    return settings


class UserFunction(ConfigModel):
    """A function of your own in place of a stage."""

    function: FunctionName = Field(
        description="package.module:function, or the name that an installed package offers; 'ours' for our method"
    )
    settings: Annotated[dict[str, JsonValue], AfterValidator(_usable)] = Field(
        {}, description="keyword arguments that it is called with"
    )
    limit_s: float = Field(
        CALL_LIMIT_S, ge=0.1, le=1e6, description="time of a call after which it counts as hanging"
    )


class UserFunctions(ConfigModel):
    """Functions of your own in place of our stages; docs/stages.md says what each gets and returns."""

    channel: UserFunction | None = Field(None, description="in place of channel estimation, stop by stop")
    mapping: UserFunction | None = Field(None, description="in place of mapping from known receiver states")
    slam: UserFunction | None = Field(None, description="in place of SLAM")
    shapes: UserFunction | None = Field(None, description="in place of the contours of objects")
    tracker: UserFunction | None = Field(None, description="in place of the tracks of what moves")

    def of(self, stage: Stage) -> UserFunction | None:
        """The function in place of a stage, None where the stage is ours."""
        function: UserFunction | None = getattr(self, stage)
        return None if function is None or function.function == OURS else function

    @property
    def given(self) -> dict[Stage, UserFunction]:
        """All functions by their stage."""
        found = {stage: self.of(stage) for stage in STAGES}
        return {stage: function for stage, function in found.items() if function is not None}


def with_functions(config: M, named: Mapping[str, str | None], limit_s: float | None = None) -> M:
    """The settings of a campaign with functions by name in place of stages; None leaves a stage as it is.

    A function that the settings name already keeps its keyword arguments. `limit_s` shortens the limits of all.
    Raises `ValueError` for a name that cannot be one.
    """
    functions: UserFunctions = getattr(config, "functions")  # noqa: B009  (of a model above this package)
    changed: dict[str, Any] = {}
    for stage in STAGES:
        name, held = named.get(stage), getattr(functions, stage)
        if name is not None and (held is None or held.function != name):
            held = _function(stage, name)
        if held is not None and limit_s is not None and limit_s < held.limit_s:
            held = held.model_copy(update={"limit_s": limit_s})
        changed[stage] = held
    return config.model_copy(update={"functions": UserFunctions.model_construct(**changed)})


def _function(stage: Stage, name: str) -> UserFunction:
    try:
        return UserFunction(function=name)
    except ValueError as error:
        raise ValueError(f"{stage} = '{name[:80]}': write it as package.module:function") from error
