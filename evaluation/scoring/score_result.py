"""What scoring a reconstruction gives: figures of each region, features, and the file ``scores.json``."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.scoring.disparity import DisparityScore
from evaluation.scoring.feature_fits import Feature
from evaluation.scoring.slope_errors import SlopeScore
from scenes.support.atomic_file import replacing
from scenes.support.notebook import Displayed

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class RegionScore:
    """Figures of one label; None where no pixel gives them. Statistics are over the region's measured pixels."""

    pixels: int
    """The label's lit pixels (see `scored`)."""
    coverage: float | None
    """Fraction of them measured: valid, with a finite height."""
    bias_mm: float | None
    """Mean error."""
    rms_mm: float | None
    """Root mean square error; ``rms^2 = bias^2 + sd^2``."""
    sd_mm: float | None
    """Standard deviation of the error about its mean."""
    median_abs_mm: float | None
    """Median of the absolute error."""
    p95_abs_mm: float | None
    """95th percentile of the absolute error."""
    max_abs_mm: float | None
    """Largest absolute error."""
    outlier_fraction: float | None
    """Fraction of measured pixels whose error their own predicted noise does not explain (see `score`)."""
    flagged_fraction: float | None
    """Fraction of the lit pixels that the decoder itself rejected."""
    predicted_sd_mm: float | None
    """Root mean square of the decoder's predicted standard deviations."""
    render_to_sensor_noise: float | None = None
    """Root mean square of the height noise of light paths over `predicted_sd_mm`, over the same pixels; None: not known."""
    total_outlier_fraction: float | None = None
    """As `outlier_fraction`, by the sigma of all causes (`decode.Reconstruction.total_sigma_mm`); None: none was looked for."""
    total_sd_mm: float | None = None
    """Root mean square of that sigma."""


@dataclass(frozen=True)
class UnlitScore:
    """Pixels that see the scene but that no projector lights: nothing can be measured there."""

    pixels: int
    valid: int
    """How many of them the decoder declares valid."""


@dataclass(frozen=True, repr=False)
class Score(Displayed):
    """How well a scene was measured: the content of ``scores.json``."""

    scene: str
    """Name of the scene."""
    regions: Mapping[str, RegionScore]
    features: Mapping[str, Feature]
    unlit: UnlitScore
    light: Mapping[str, Any] | None = None
    """Render noise reached, where a limit was asked for."""
    forced: tuple[str, ...] = ()
    """Parts of the scene in which reconstruction and truth differ, where they were scored by force."""
    slopes: Mapping[str, SlopeScore] | None = None
    """Slopes by label, of deflectometry; None: not measured."""
    stereo: Mapping[str, DisparityScore] | None = None
    """Of two cameras: shares of bad matches by label."""

    def _facts(self) -> dict[str, str]:
        def of(value: float | None) -> str:
            return "-" if value is None else f"{1e3 * value:.3g}"

        return {"scene": self.scene} | {
            label: f"RMS {of(region.rms_mm)} µm, predicted {of(region.predicted_sd_mm)} µm"
            for label, region in self.regions.items()
        }

    def plot(self, small: bool = False) -> "Figure":
        """Draw measured and predicted error of each region; `small`: a smaller figure."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(4.5, 3.0) if small else (7.0, 4.0), layout="constrained")
        axes = figure.subplots()
        at = np.arange(len(self.regions))
        for offset, name, label in ((-0.2, "rms_mm", "RMS"), (0.2, "predicted_sd_mm", "predicted")):
            values = [getattr(region, name) for region in self.regions.values()]
            heights = [np.nan if value is None else 1e3 * value for value in values]
            axes.bar(at + offset, heights, 0.4, label=label)
        axes.set_xticks(at, list(self.regions), fontsize=8)
        axes.set_ylabel("height error (µm)")
        figure.legend(loc="outside upper right", ncols=2, fontsize=8)
        return figure

    def to_dict(self) -> dict[str, Any]:
        """Plain data with None where there is no figure; always valid JSON."""
        light = {} if self.light is None else {"light": dict(self.light)}
        return {
            "scene": self.scene,
            "regions": {label: asdict(region) for label, region in self.regions.items()},
            "features": {name: asdict(feature) for name, feature in self.features.items()},
            "unlit": asdict(self.unlit),
            **light,
            **({"slopes": {k: asdict(v) for k, v in self.slopes.items()}} if self.slopes else {}),
            **({"stereo": {n: asdict(s) for n, s in self.stereo.items()}} if self.stereo else {}),
            **({"forced": list(self.forced)} if self.forced else {}),
        }

    def write(self, path: str | Path) -> None:
        """Write as JSON, atomically; raises `FileError`."""
        text = json.dumps(self.to_dict(), indent=2, allow_nan=False)
        with replacing(path) as temporary:
            temporary.write_text(text + "\n", "utf-8")
