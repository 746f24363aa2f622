"""The observation record: the data that a receiver has at one stop, and nothing else."""

from dataclasses import dataclass

from scenes.pose import Pose
from scenes.record import ComplexArray, FloatArray, Record, array
from sim.signal.arrays.codebook import Codebook


@dataclass(frozen=True)
class BeamClock(Record):
    """When the beam pairs of a sweep are measured: at the time of the TX beam plus that of the RX beam.

    Times are relative to the middle of the sweep, and means where a pair is measured several times.
    """

    tx_s: FloatArray = array("tx_beam", unit="s", doc="time of every TX beam")
    rx_s: FloatArray = array("rx_beam", unit="s", doc="time of every RX beam")


@dataclass(frozen=True)
class BeamSweep(Record):
    """Samples of all TX beams x RX beams at one stop, and the known properties of the signal.

    Equation (1) of the paper: samples[m, n, k] = sum_i xi_i G_TX^m(phi_i) G_RX^n(theta_i)
    exp(-j 2 pi f_k tau_i) x[m, k] + w, with f_k the frequency offset from the carrier and tau_i including
    the receiver's unknown clock bias. Only the occupied (comb) subcarriers are kept.

    The index l of equation (1), over the symbols of a PRS resource, has no axis here. Either a beam pair takes one
    symbol. Or the receiver divides by the pilots, averages the symbols of each subcarrier and combines the
    interleaved combs; then the samples cover every subcarrier and `prs_symbol` is that of the first comb pass.

    Codebooks are nominal: the designed weights, patterns and panels, without hardware impairments. With a `clock`
    paths may have Doppler shifts; without one the world is taken as frozen. The TX pose is NaN where the TX walks
    and the receiver stands (uplink): nobody knows it.
    """

    tx_codebook: Codebook
    rx_codebook: Codebook
    tx_pose: Pose
    stop: int = array(dtype=int, doc="index of the receiver stop")
    samples: ComplexArray = array(
        "tx_beam", "rx_beam", "subcarrier", unit="sqrt(mW)", dtype="complex64", doc="received samples"
    )
    prs_symbol: ComplexArray = array("tx_beam", "subcarrier", dtype="complex64", doc="transmitted, |x| = 1")
    frequency_offset_hz: FloatArray = array("subcarrier", unit="Hz", doc="subcarrier offset from the carrier")
    carrier_hz: float = array(unit="Hz", doc="carrier frequency")
    noise_power_mw: FloatArray = array("rx_beam", unit="mW", doc="nominal noise power per sample")
    clock: BeamClock | None = None  # absent where nothing moves
