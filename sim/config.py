"""Settings of a simulated campaign: waveform, arrays, link, clock and propagation."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PrivateAttr, field_validator, model_validator

from scenes.names import FileName
from scenes.toml_config import ConfigModel
from sim.signal.hardware.config import ImpairmentsConfig
from sim.signal.waveform.config import Bits, ScanOrder, ScheduleConfig
from sim.signal.waveform.prs import PrsConfig
from sim.signal.waveform.schedule import sent_slots

Comb = Literal[2, 4, 6, 12]
AngleDeg = Annotated[float, Field(ge=-360, le=360)]
ElevationDeg = Annotated[float, Field(ge=-90, le=90)]


class WaveformConfig(ConfigModel):
    """The PRS in the OFDM grid, TS 38.211 clause 7.4.1.7."""

    carrier_ghz: float = Field(60.0, gt=1, le=300, description="carrier frequency")
    numerology: Literal[2, 3] = Field(3, description="mu: subcarrier spacing 15 kHz x 2^mu")
    n_rb: int = Field(264, ge=24, le=272, multiple_of=4, description="resource blocks of 12 subcarriers")
    comb: Comb = Field(2, description="every comb-th subcarrier of a symbol is occupied")
    n_symbols: Literal[2, 4, 6, 12] | None = Field(
        None, description="symbols of a PRS resource, by default as many as the comb size"
    )
    rb_offset: int = Field(0, ge=0, le=251, description="resource block of the carrier where the PRS starts")
    re_offset: int = Field(0, ge=0, le=11, description="first occupied subcarrier, below the comb size")
    first_symbol: int = Field(0, ge=0, le=12, description="symbol of the slot where the resource starts")
    carrier_rb: int | None = Field(
        None, ge=24, le=275, description="resource blocks of the carrier; by default it ends with the PRS"
    )
    sequence_id: int = Field(
        0, ge=0, le=4095, description="PRS sequence of the first TX beam; the next beams have the next ones"
    )
    combine_symbols: bool = Field(
        False,
        description="a beam pair combines all symbols of a resource; otherwise it takes the first symbol alone",
    )
    cyclic_prefix: Literal["normal", "extended"] = Field("normal", description="extended with numerology 2 alone")
    scan_order: ScanOrder = Field(
        "linear", description="order of the beams in a sweep: linear, interleaved or random, at both ends"
    )
    schedule: ScheduleConfig | None = Field(
        None, description="slots in which the beams are sent; without it one symbol follows the other"
    )

    @model_validator(mode="after")
    def _follow_the_standard(self) -> Self:
        try:
            prs = self.prs
            if self.schedule is not None:
                sent_slots(self.schedule.of_resource(prs.numerology), 1)
        except ValueError as error:
            text = str(error).removeprefix("PrsConfig.")
            raise ValueError(text.replace("PrsSchedule", "schedule", 1)) from None
        return self

    @property
    def prs(self) -> PrsConfig:
        """The PRS resource that every beam sends."""
        return PrsConfig(
            n_rb=self.n_rb,
            comb=self.comb,
            numerology=self.numerology,
            rb_offset=self.rb_offset,
            re_offset=self.re_offset,
            first_symbol=self.first_symbol,
            n_symbols=self.n_symbols,
            carrier_rb=self.carrier_rb,
            cyclic_prefix=self.cyclic_prefix,
        )


class ArrayConfig(ConfigModel):
    """A uniform planar array, the orientations of its panels and the beams of each."""

    rows: int = Field(4, ge=1, le=256, description="rows of elements of a panel")
    columns: int = Field(16, ge=1, le=256, description="columns of elements of a panel")
    element_pattern: Literal["tr38901", "isotropic"] = Field(
        "tr38901", description="pattern of an element: TR 38.901, or the same in all directions"
    )
    polarisation_slant_deg: ElevationDeg = Field(0.0, description="slant of the elements, 0 is vertical")
    panel_azimuth_deg: list[AngleDeg] = Field([0.0], min_length=1, description="panel boresights, device frame")
    panel_tilt_deg: list[ElevationDeg] = Field(
        [0.0], min_length=1, description="elevation of the panel boresights, one for all or one each"
    )
    codebook: Literal["steered", "dft", "campus_63", "hierarchical", "file"] = Field(
        "steered",
        description="beams of a panel: a grid of angles, a Fourier matrix, the 63 of the measured campaign, ever "
        "narrower ones, or those of a file",
    )
    beams_per_panel: int = Field(32, ge=1, le=1024, description="steered: beams, uniform in the sine of azimuth")
    sector_deg: float = Field(
        140.0, gt=0, le=180, description="steered, hierarchical, campus_63: azimuth sector of each panel"
    )
    beam_elevation_deg: list[ElevationDeg] = Field(
        [0.0], min_length=1, description="steered, campus_63: elevations of the beams in the panel frame"
    )
    hierarchy_levels: int = Field(4, ge=1, le=9, description="hierarchical: levels of 1, 2, 4, ... beams")
    weights_file: FileName | None = Field(None, description="file: .npz or .csv with the weights of each beam")
    taper: Literal["uniform", "taylor", "chebyshev"] = Field("uniform", description="amplitude over the array")
    taper_side_lobe_db: float = Field(30.0, ge=15, le=80, description="side lobes of a taper below the main lobe")
    phase_bits: int | None = Field(None, ge=1, le=16, description="bits of the phase shifters, none for ideal")

    @model_validator(mode="after")
    def _agree(self) -> Self:
        if len(self.panel_tilt_deg) not in (1, len(self.panel_azimuth_deg)):
            raise ValueError(
                f"panel_tilt_deg = {self.panel_tilt_deg}: must have 1 value or one for each of"
                f" {len(self.panel_azimuth_deg)} panels"
            )
        if (self.codebook == "file") != (self.weights_file is not None):
            raise ValueError(
                f"weights_file = {self.weights_file}: must be given with codebook = 'file', and only with it"
            )
        return self


RX_ARRAY = ArrayConfig(panel_azimuth_deg=[-180.0, -90.0, 0.0, 90.0], beams_per_panel=24, sector_deg=90.0)


class LinkConfig(ConfigModel):
    """The link budget. The converter shapes the budget of `arena link`, not the samples."""

    tx_power_dbm: float = Field(3.0, ge=-50, le=60, description="power into the TX array")
    noise_figure_db: float = Field(10.0, ge=0, le=40, description="noise figure of the receiver")
    adc_effective_bits: float = Field(6.0, ge=1, le=24, description="ENOB of the receiver's converters")
    adc_back_off_db: float = Field(
        12.0, ge=0, le=40, description="strongest signal of the campaign below a full-scale sine, at fixed gain"
    )


class ClockConfig(ConfigModel):
    """The receiver clock, unknown to the estimators: an initial bias and a random walk over the stops."""

    initial_bias_ns: float = Field(33.0, ge=-200, le=200, description="clock bias before the first stop")
    walk_std_ns: float = Field(3.3, ge=0, le=50, description="standard deviation of the step per stop")
    tx_offset_std_ns: float = Field(
        10.0, ge=0, le=200, description="several TX: standard deviation of the clock of a TX about the first one"
    )
    tx_walk_std_ns: float = Field(
        0.0, ge=0, le=50, description="several TX: standard deviation of the step of that offset per stop"
    )


class PropagationConfig(ConfigModel):
    """Settings of the propagation.

    Specular rays only search for sequences of faces. Each sequence is then solved exactly: more rays add no paths
    once every reflecting face is hit. Diffuse rays leave the TX in fixed directions; each one represents its share
    of the sphere. Their number sets the angular resolution, not the power.
    """

    max_bounces: int = Field(2, ge=0, le=3, description="specular bounces of a path, 0 for line of sight alone")
    specular_samples: int = Field(200_000, ge=1, le=10_000_000, description="rays that look for faces")
    diffuse_samples: int = Field(2_000, ge=0, le=1_000_000, description="rays that scatter, 0 for none")
    diffraction: bool = Field(
        True, description="first order, at vertical edges, edges of meshes, and round smooth solids"
    )
    transmission: bool = Field(False, description="whether paths go through thin walls and hollow solids")
    compare_planar: bool = Field(
        True, description="compare the ray tracer's planar paths with the exact ones, where it is needed at all"
    )
    max_crossed_faces: int = Field(4, ge=1, le=16, description="faces that one path may go through")
    max_transmission_loss_db: float = Field(
        30.0, gt=0, le=200, description="paths that lose more on their way through faces are left out"
    )
    retrace_phase_deg: float = Field(
        1.0,
        ge=0.01,
        le=90,
        description="in a world that moves, a sweep is traced again inside where the second order of"
        " a path errs by more, times its gain over the strongest",
    )
    deepmimo: FileName | None = Field(
        None, description="folder: paths of this DeepMIMO v4 scenario in place of traced ones"
    )

    @property
    def n_bounce_slots(self) -> int:
        """Bounce slots of every path record."""
        return max(1, self.max_bounces + (self.max_crossed_faces if self.transmission else 0))


class TransmitterConfig(ConfigModel):
    """What one of several TX has of its own: power, array, and PRS resource set; by default that of the campaign.

    Without a resource of their own the TX are orthogonal: each takes the next comb offset, and when all are taken
    the next ones send after the others. TX with equal resources collide: each is interference to the other.
    """

    tx_power_dbm: float | None = Field(None, ge=-50, le=60, description="power into the array")
    array: ArrayConfig | None = Field(None, description="the array; what is left out is that of tx_array")
    sequence_id: int | None = Field(
        None, ge=0, le=4095, description="PRS sequence of the first beam; by default after those of the TX before"
    )
    re_offset: int | None = Field(None, ge=0, le=11, description="comb offset, below the comb size")
    turn: int | None = Field(
        None, ge=0, le=63, description="sweeps that are sent before this one; with a schedule, in the same period"
    )
    first_symbol: int | None = Field(None, ge=0, le=12, description="symbol of the slot where a resource starts")
    muting_1: Bits | None = Field(None, description="with a schedule: a bit for every instance, 0 for muted")
    muting_2: Bits | None = Field(None, description="with a schedule: a bit for every repetition, 0 for muted")


NodeNames = str | Annotated[list[str], Field(min_length=1)]


class StatedLinks(ConfigModel):
    """Who sends and who receives: every TX with every receiver of the entry.

    A TX of the scene is a fixed node; it may receive. A walk is what walks; it may send. A fixed node that hears
    itself is monostatic: its receiver is a panel of its own beside the other, and both have one clock.
    """

    tx: NodeNames = Field(description="what sends: TX of the scene, walks, or 'all' TX")
    rx: NodeNames = Field(description="what receives: walks, TX of the scene as fixed nodes, or 'all' of these")
    panel_offset_m: list[float] = Field(
        [0.0, 0.2, 0.0],
        min_length=3,
        max_length=3,
        description="monostatic: receiving panel from the other, x ahead, y left, z up",
    )
    isolation_db: float = Field(
        57.0, ge=20, le=200, description="monostatic: leakage from panel to panel below the power sent"
    )
    n_sweeps: int = Field(
        1, ge=1, le=10_000, description="to fixed nodes: sweeps one after the other, each a stop"
    )
    sweep_interval_s: float = Field(
        0.0, ge=0, le=3600, description="from sweep to sweep, 0 for no longer than a sweep takes"
    )


class LinkKind(StrEnum):
    """What the ends of a link are."""

    DOWNLINK = "downlink"  # a fixed node sends, the walk receives
    UPLINK = "uplink"  # the walk sends, a fixed node receives
    NODES = "nodes"  # a fixed node sends, others receive
    MONOSTATIC = "monostatic"  # a fixed node hears itself

    @property
    def has_walk(self) -> bool:
        """Whether an end of it walks."""
        return self in (LinkKind.DOWNLINK, LinkKind.UPLINK)


@dataclass(frozen=True)
class LinkRole:
    """What the settings of one link of several are about.

    `node` is the number of the fixed node at which its paths are anchored, `receiver` that of the node at a stop
    where no walk is there. `sender` is the number of what sends: links of one sender are one signal.
    """

    number: int = 0
    turn: int = 0
    node: int = 0
    sender: int = 0
    receiver: int | None = None
    kind: LinkKind = LinkKind.DOWNLINK
    isolation_db: float = 0.0


class SimulationConfig(ConfigModel):
    """One campaign: a scene, a seed and the settings of every simulated part."""

    scene: FileName = Field(description="library name or path of the scene file")
    tx: NodeNames | None = Field(
        None, description="TX to use where the scene has several, a list of them, or 'all'; by default the first"
    )
    transmitters: dict[str, TransmitterConfig] = Field({}, description="several TX: what one has of its own")
    walk: NodeNames | None = Field(
        None, description="walk to use where the scene has several, or a list of them; by default the first"
    )
    links: list[StatedLinks] = Field([], description="who sends to whom, in place of tx and walk")
    seed: int = Field(1, ge=0, lt=2**63, description="seed of all random numbers of the simulation")
    waveform: WaveformConfig = WaveformConfig()
    tx_array: ArrayConfig = ArrayConfig()
    rx_array: ArrayConfig = RX_ARRAY
    link: LinkConfig = LinkConfig()
    clock: ClockConfig = ClockConfig()
    impairments: ImpairmentsConfig = ImpairmentsConfig()
    propagation: PropagationConfig = PropagationConfig()
    _role: LinkRole = PrivateAttr(LinkRole())

    @property
    def role(self) -> LinkRole:
        """Which link of a campaign these settings are of (`sim.links.tx_links`)."""
        return self._role

    @property
    def tx_number(self) -> int:
        """Which of the TX (or links) of a campaign these settings are of: 0 is the first."""
        return self._role.number

    @property
    def turn(self) -> int:
        """Sweeps of other TX that are sent before the one of this TX."""
        return self._role.turn

    @property
    def end_arrays(self) -> tuple[ArrayConfig, ArrayConfig]:
        """The arrays of the fixed node and of what is at a stop, whichever of them sends."""
        ends = self.tx_array, self.rx_array
        return ends[::-1] if self._role.kind == LinkKind.UPLINK else ends

    def of_link(self, role: LinkRole, **changes: Any) -> Self:
        """The settings of one link of several, with what is its own in `changes`."""
        made = self.model_copy(update={"transmitters": {}, "links": [], **changes})
        made._role = role
        return made

    @model_validator(mode="after")
    def _name_ends_once(self) -> Self:
        for name in ("tx", "walk"):
            if self.links and getattr(self, name) is not None:
                raise ValueError(
                    f"{name} = {getattr(self, name)!r}: links name what sends and receives, leave it out"
                )
        return self

    @model_validator(mode="before")
    @classmethod
    def _keep_the_array_of_all_tx(cls, data: Any) -> Any:
        """What an `array` table of one TX leaves out is that of `tx_array`."""
        own = data.get("transmitters") if isinstance(data, dict) else None
        if not isinstance(own, dict):
            return data
        base = data.get("tx_array", {})
        base = base.model_dump() if isinstance(base, ArrayConfig) else base
        merged = {
            name: one | {"array": base | one["array"]}
            if isinstance(one, dict) and isinstance(one.get("array"), dict) and isinstance(base, dict)
            else one
            for name, one in own.items()
        }
        return data | {"transmitters": merged}

    @field_validator("rx_array", mode="before")
    @classmethod
    def _keep_the_defaults_of_the_receiver(cls, value: Any) -> Any:
        """What an `rx_array` table leaves out is that of the default receiver, as documented, not of one panel."""
        return RX_ARRAY.model_dump() | value if isinstance(value, dict) else value
