"""Bad channel estimators: 30 ways in which a user's function can fail or misbehave."""

BODIES = {
    "raises": "raise KeyError('mine')",
    "raises_long": "raise ValueError('x' * 100_000)",
    "raises_lines": "raise RuntimeError('a\\nb\\nc')",
    "raises_nothing": "raise Exception",
    "raises_base": "raise BaseException('base')",
    "raises_disk": "raise OSError(28, 'No space left on device')",
    "raises_memory": "raise MemoryError",
    "raises_exit": "raise GeneratorExit",
    "leaves": "sys.exit(0)",
    "leaves_late": "sys.exit('late') if sweep.stop == 2 else None; return good(sweep)",
    "dies": "os._exit(0)",
    "dies_late": "os._exit(0) if sweep.stop == 2 else None; return good(sweep)",
    "kills_itself": "os.kill(os.getpid(), signal.SIGKILL)",
    "crashes": "ctypes.string_at(0)",
    "aborts": "os.abort()",
    "interrupted": "raise KeyboardInterrupt",
    "recurses": "return recurses(sweep)",
    "late": "return 1 / 0 if sweep.stop == 2 else good(sweep)",
    "nothing": "return None",
    "a_number": "return 3.0",
    "a_sweep": "return sweep",
    "another_stop": "return replace(good(sweep), stop=99)",
    "the_class": "return ChannelEstimate",
    "not_finite": "found = good(sweep); return replace(found, delay_s=found.delay_s * np.nan)",
    "wrong_shape": "found = good(sweep); return replace(found, delay_s=found.delay_s[:1])",
    "a_generator": "yield good(sweep)",
    "writes_samples": "sweep.samples[:] = 0; return good(sweep)",
    "takes_memory": "return np.ones(10**14)",
    "spins": "\n    while True: pass",
    "moves_and_fails": "os.chdir('/'); np.seterr(all='raise'); warnings.simplefilter('error'); return 1 / 0",
}
HEAD = """
import ctypes, os, signal, sys, warnings
from dataclasses import replace
import numpy as np
from estimation.channel.config import ChannelConfig
from estimation.channel.estimate import estimate_channel
from estimation.channel.record import ChannelEstimate

def good(sweep):
    return estimate_channel(sweep, config=ChannelConfig(method="power"))
"""
SOURCE = HEAD + "".join(f"\ndef {name}(sweep):\n    {body}\n" for name, body in BODIES.items())
