"""Linear light: what each camera pixel returns of each basis channel."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from scenes import exr, exr_bands, mapped
from scenes.basis import Basis, Channel
from scenes.errors import FileError, RenderError, SceneError
from scenes.exr_bands import Bands
from scenes.frozen import in_words
from scenes.load import dumps, parse
from scenes.scene import Sampling, Scene

KIND = "transport"


@dataclass(frozen=True)
class PhaseError:
    """How far light's own noise was brought down: see `render.trace`. Of the finest fringe, over the lit pixels."""

    target_rad: float
    """What was asked for."""
    reached_rad: float | None
    """95 % of the pixels are off by less, as estimated from the scatter between passes; None: no pixel shows a fringe."""
    bound_rad: float | None
    """Upper confidence bound (95 %) of `reached_rad`: what must be below the target."""
    passes: int
    pixels: int
    """Pixels it was judged on."""

    @property
    def met(self) -> bool:
        """Whether it was brought below the target."""
        return self.bound_rad is not None and self.bound_rad <= self.target_rad

    def to_dict(self) -> dict[str, Any]:
        """Plain data, always valid JSON."""
        return asdict(self) | {"met": self.met}


@dataclass(frozen=True, eq=False)
class Transport:
    """The response of every camera pixel to a basis of the patterns, in radiance, W/(m^2 sr).

    Linear light: `frames` turns it into images of any patterns the basis spans, and `render.expose` into a stack.
    """

    total: NDArray[np.float32]
    """All light from the projectors, (projector, channel, row, col); channels a projector lacks are 0."""
    direct: NDArray[np.float32]
    """The part of `total` scattered once, at the first surface; same axes."""
    ambient: NDArray[np.float32]
    """Ambient light, (row, col)."""
    label: NDArray[np.uint16]
    """What each pixel's centre sees, (row, col): i + 1 for `labels[i]`, 0 for nothing."""
    labels: tuple[str, ...]
    bases: tuple[Basis, ...]
    """Each projector's channels and the weights that make its frames."""
    scene: Scene
    seed: int
    samples: int
    depth: int
    phase_error: PhaseError | None = None
    """Of a trace that went on until it was small enough; None: the samples were given."""

    def frames(self, projector: int = 0, direct_only: bool = False) -> NDArray[np.float32]:
        """Radiance of the scene's patterns from one projector, ambient light included, (frame, row, col).

        Raises `RenderError` for a projector the scene lacks.
        """
        if not 0 <= projector < len(self.bases):
            raise RenderError(
                f"projector {projector} does not exist: the scene has {len(self.bases)}, counted from 0"
            )
        basis = self.bases[projector]
        light = (self.direct if direct_only else self.total)[projector, : len(basis.channels)]
        weights = basis.weights.astype(np.float32)
        frames: NDArray[np.float32] = np.tensordot(weights, light, axes=1) + self.ambient
        return frames

    def write(self, path: str | Path) -> None:
        """Write as EXR: ``P<projector>.total.C<channel>``, ``P<projector>.direct.C<channel>``, ``ambient``, ``label``.

        Float32 without loss: half would cost up to 7e-4 rad of phase.
        """
        channels: dict[str, NDArray[Any]] = {
            "ambient": self.ambient,
            "label": self.label.astype(np.uint32),
        }
        for p, basis in enumerate(self.bases):
            for c in range(len(basis.channels)):
                channels[f"P{p}.total.C{c:03d}"] = self.total[p, c]
                channels[f"P{p}.direct.C{c:03d}"] = self.direct[p, c]
        meta = {
            "units": {"total": "W/(m^2 sr)", "direct": "W/(m^2 sr)", "ambient": "W/(m^2 sr)"},
            "labels": list(self.labels),
            "bases": [
                {
                    "channels": [asdict(channel) for channel in basis.channels],
                    "weights": basis.weights.tolist(),
                }
                for basis in self.bases
            ],
            "scene": dumps(self.scene),
            "seed": self.seed,
            "samples": self.samples,
            "depth": self.depth,
            "phase_error": None if self.phase_error is None else asdict(self.phase_error),
        }
        exr.write(path, KIND, channels, meta)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a transport file; raises `FileError` on anything but a whole one of this version."""
        with exr_bands.reading(path, KIND) as bands:
            meta = bands.meta
            try:
                sampling = Sampling(samples=meta["samples"], depth=meta["depth"])
                bases = tuple(
                    Basis(
                        tuple(
                            Channel(**c | {"values": tuple(c["values"])})
                            for c in stored["channels"]
                        ),
                        np.asarray(stored["weights"], dtype=np.float64),
                    )
                    for stored in meta["bases"]
                )
                light, ambient, label = _images(bands, bases, f"'{path}'")
                return cls(
                    light[0],
                    light[1],
                    ambient,
                    label,
                    tuple(str(label) for label in meta["labels"]),
                    bases,
                    parse(str(meta["scene"]), where=str(path)),
                    int(meta["seed"]),
                    sampling.samples,
                    sampling.depth,
                    _phase_error(meta.get("phase_error")),
                )
            except (KeyError, TypeError, ValueError, SceneError) as error:
                raise FileError(
                    f"'{path}': its transport header or channels are damaged: {in_words(error)}"
                ) from error


def _images(
    bands: Bands, bases: Sequence[Basis], source: str
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint16]]:
    """Light (total and direct, projector, channel, row, col), ambient light and labels; `KeyError` if one is missing."""
    most = max(len(basis.channels) for basis in bases)
    ambient, label = np.empty((0, 0), np.float32), np.empty((0, 0), np.uint16)
    light: NDArray[Any] | None = None
    for rows, channels in bands:
        # A header may claim any size; a band that could be read bears out the width.
        if light is None:
            shape = (2, len(bases), most, *bands.size)
            light = mapped.array(shape, np.float32, source, "read it on a larger machine")
            ambient, label = np.empty(bands.size, np.float32), np.empty(bands.size, np.uint16)
        for images, kind in zip(light, ("total", "direct"), strict=True):
            for p, basis in enumerate(bases):
                images[p, len(basis.channels) :, rows] = 0.0
                for c in range(len(basis.channels)):
                    images[p, c, rows] = channels[f"P{p}.{kind}.C{c:03d}"]
        ambient[rows] = channels["ambient"]
        label[rows] = exr.whole(channels["label"], np.uint16)
        mapped.let_go(light)
    assert light is not None  # an image has a row
    return light, ambient, label


def _phase_error(stored: dict[str, Any] | None) -> PhaseError | None:
    if stored is None:
        return None
    numbers = {name: stored[name] for name in ("reached_rad", "bound_rad")}
    return PhaseError(
        target_rad=float(stored["target_rad"]),
        passes=int(stored["passes"]),
        pixels=int(stored["pixels"]),
        **{name: None if value is None else float(value) for name, value in numbers.items()},
    )
