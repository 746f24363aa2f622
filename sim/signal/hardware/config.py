"""Settings of the hardware impairments: every one has a unit and is off by default."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import Field

from scenes.toml_config import ConfigModel

# Each impairment by its usual name, with the settings that enable it.
IMPAIRMENTS: Mapping[str, tuple[str, ...]] = {
    "clock bias": ("clock_bias_std_ns",),
    "clock drift": ("clock_drift_ppm",),
    "CFO": ("cfo_hz",),
    "phase noise, per pair": ("phase_noise_pair_deg",),
    "phase noise, within symbol": ("phase_noise_linewidth_hz",),
    "IQ imbalance": ("iq_gain_db", "iq_phase_deg"),
    "ADC quantisation": ("adc_bits",),
    "ADC clipping": ("adc_clip_db",),
    "element errors": ("element_gain_std_db", "element_phase_std_deg"),
    "mutual coupling": ("coupling_db",),
    "pointing offset": ("tx_pointing_offset_deg",),
    "RX placement": ("rx_placement_std_m",),
    "RX heading": ("rx_heading_std_deg",),
    "beam phase": ("beam_phase_std_deg",),
}


class ImpairmentsConfig(ConfigModel):
    """Impairments of the hardware and of the survey. All are off by default."""

    clock_bias_std_ns: float = Field(0.0, ge=0, le=100, description="extra clock bias, drawn at every stop")
    clock_drift_ppm: float = Field(
        0.0, ge=-100, le=100, description="rate of the receiver clock over a sweep, which starts without it"
    )
    cfo_hz: float = Field(0.0, ge=-50e3, le=50e3, description="carrier frequency offset of the receiver")
    phase_noise_pair_deg: float = Field(
        0.0, ge=0, le=180, description="phase step from one beam pair to the next, a random walk"
    )
    phase_noise_linewidth_hz: float = Field(
        0.0, ge=0, le=1e5, description="full 3 dB linewidth of the oscillator, a Wiener phase within each symbol"
    )
    iq_gain_db: float = Field(0.0, ge=-6, le=6, description="gain of Q over I in the receiver")
    iq_phase_deg: float = Field(0.0, ge=-45, le=45, description="error of the quadrature in the receiver")
    adc_bits: int | None = Field(None, ge=1, le=16, description="bits of each converter")
    adc_full_scale_db: float = Field(
        15.0, ge=0, le=60, description="full scale over the rms per converter of the strongest beam pair"
    )
    adc_clip_db: float | None = Field(
        None, ge=-20, le=60, description="clipping level over the rms per converter of the strongest beam pair"
    )
    element_gain_std_db: float = Field(0.0, ge=0, le=6, description="gain errors of the array elements")
    element_phase_std_deg: float = Field(0.0, ge=0, le=180, description="phase errors of the array elements")
    coupling_db: float | None = Field(
        None, ge=-60, le=-6, description="coupling of elements half a wavelength apart, falling with distance"
    )
    tx_pointing_offset_deg: float = Field(0.0, ge=-45, le=45, description="true over surveyed TX heading")
    rx_placement_std_m: float = Field(0.0, ge=0, le=2, description="surveyed RX position, each coordinate")
    rx_heading_std_deg: float = Field(0.0, ge=0, le=45, description="surveyed RX heading")
    beam_phase_std_deg: float = Field(
        0.0, ge=0, le=360, description="phase of every TX beam and every RX beam, the same at all stops"
    )

    def only(self, name: str) -> ImpairmentsConfig:
        """The same settings with only one impairment; `ValueError` for an unknown name."""
        if name not in IMPAIRMENTS:
            raise ValueError(f"impairment = '{name}': must be one of {', '.join(IMPAIRMENTS)}")
        kept = {field: getattr(self, field) for field in (*IMPAIRMENTS[name], "adc_full_scale_db")}
        return ImpairmentsConfig(**kept)

    @property
    def switched_on(self) -> list[str]:
        """Names of the impairments that are on."""
        off = ImpairmentsConfig()
        return [
            name
            for name, settings in IMPAIRMENTS.items()
            if any(getattr(self, setting) != getattr(off, setting) for setting in settings)
        ]
