"""Linear light: what each camera pixel returns of each basis channel."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from render.fringe_phasor import finest_fringes, measuring_axis
from scenes.acquisition.pattern_basis import Basis, Channel
from scenes.files import exr, exr_rows
from scenes.files.exr_rows import Bands
from scenes.scene import Sampling, Scene
from scenes.scene_files import dumps, parse
from scenes.support import mapped
from scenes.support.errors import FileError, RenderError, SceneError
from scenes.support.notebook import Displayed, PreviewPlane
from scenes.support.validation_words import in_words

KIND = "transport"
# Layers of the light paths' noise.
PHASE, AMPLITUDE, CORRELATION = "render_noise_rad", "amplitude_noise", "noise_correlation"
# What the names of the second camera's layers start with.
SECOND = "second."
# A ratio that was reached may miss its target by so much, its own uncertainty, and count as met.
TOLERANCE = 1.05


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


@dataclass(frozen=True)
class RenderNoise:
    """Noise of light paths over the sensor's, in a trace that was to bring it below a target."""

    target: float
    """What was asked for."""
    reached: Mapping[str, float | None]
    """Label -> root mean square of the light's noise over that of the sensor's, over its lit pixels that can be measured;
    None: there is none."""
    paths: int
    """Light paths of all pixels."""
    cut: Mapping[str, float] = field(default_factory=dict)
    """Label -> root mean square of the phase of light beyond `depth`, which is not in the result, over that of the sensor's
    noise: an estimate from the pilot. Empty for direct light alone, and for depths that cut nothing (from 8)."""

    @property
    def met(self) -> bool:
        """Whether every label is below the target, but for the figure's own uncertainty."""
        return all(
            ratio is None or ratio <= TOLERANCE * self.target for ratio in self.reached.values()
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain data, always valid JSON."""
        return asdict(self) | {"met": self.met}


@dataclass(frozen=True, eq=False, repr=False)
class Transport(Displayed):
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
    noise_rad: NDArray[np.float32] | None = None
    """(fringe, projector, row, col) standard deviation of the phase of each axis's finest fringe from light paths alone, in the
    order of `render.fringe_phasor.finest_fringes`; NaN where a pixel has no fringe. None: not known."""
    render_noise: RenderNoise | None = None
    """Of a trace that was to bring it below a share of the sensor's noise."""
    second: "Transport | None" = None
    """What the second camera of a pair receives; its `scene` has that camera alone."""
    amplitude_noise: NDArray[np.float32] | None = None
    """Of the shape of `noise_rad`: standard deviation of that fringe's modulation from light paths alone, W/(m^2 sr). Behind a lens
    it disturbs the phase of neighbours. None: not known."""
    noise_correlation: NDArray[np.float32] | None = None
    """Of the shape of `noise_rad`: correlation of the phase's noise with the modulation's, -1 to 1. None: taken as 0."""
    identity: exr.Identity = field(default_factory=dict)
    """Digests of what was traced, see `scenes.scene_identity`; empty: not known."""

    @property
    def render_noise_rad(self) -> NDArray[np.float32] | None:
        """(row, col) standard deviation of the finest phase from light paths alone, rad, of the first projector's axis that
        measures height; None if it is not known."""
        if self.noise_rad is None:
            return None
        axes = [fringe.axis for fringe in finest_fringes(self.scene.patterns, self.bases)]
        image: NDArray[np.float32] = self.noise_rad[measuring_axis(self.scene, axes), 0]
        return image

    def _facts(self) -> dict[str, str]:
        rows, columns = self.ambient.shape
        return {
            "scene": self.scene.name,
            "size": f"{columns} x {rows} px",
            "channels": str(sum(len(basis.channels) for basis in self.bases)),
            "samples": str(self.samples),
            "seed": str(self.seed),
        }

    def _planes(self) -> list[PreviewPlane]:
        return [
            PreviewPlane(f"Light of projector {p}", "W/(m² sr)", self.total[p, 0])
            for p in range(len(self.bases))
        ]

    def frames(self, projector: int = 0, direct_only: bool = False) -> NDArray[np.float32]:
        """Radiance of the scene's patterns from one projector, ambient light included.

        Parameters
        ----------
        projector
            Index of the projector.
        direct_only
            Whether to leave out interreflected light.

        Returns
        -------
        ndarray of float32, (frame, row, col)
            Radiance, W/(m^2 sr).

        Raises
        ------
        RenderError
            The scene does not have this projector.
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
        """Write as EXR: ``P<projector>.total.C<channel>``, ``P<projector>.direct.C<channel>``, ``ambient``, ``label``;
        the same after ``second.`` for a second camera.

        Float32 without loss: half would cost up to 7e-4 rad of phase.
        """
        channels = self._layers()
        if self.second is not None:
            channels |= {f"{SECOND}{n}": layer for n, layer in self.second._layers().items()}
        meta = {
            "units": {
                "total": "W/(m^2 sr)",
                "direct": "W/(m^2 sr)",
                "ambient": "W/(m^2 sr)",
                PHASE: "rad",
                AMPLITUDE: "W/(m^2 sr)",
                CORRELATION: "1",
            },
            "labels": list(self.labels),
            "bases": [
                {
                    "channels": [asdict(channel) for channel in basis.channels],
                    "weights": basis.weights.tolist(),
                }
                for basis in self.bases
            ],
            "scene": dumps(self.scene),
            "identity": dict(self.identity),
            "seed": self.seed,
            "samples": self.samples,
            "depth": self.depth,
            "phase_error": None if self.phase_error is None else asdict(self.phase_error),
            "render_noise": None if self.render_noise is None else asdict(self.render_noise),
        }
        exr.write(path, KIND, channels, meta)

    def _layers(self) -> dict[str, NDArray[Any]]:
        """The images of one camera, by name."""
        channels: dict[str, NDArray[Any]] = {
            "ambient": self.ambient,
            "label": self.label.astype(np.uint32),
        }
        for p, basis in enumerate(self.bases):
            for c in range(len(basis.channels)):
                channels[f"P{p}.total.C{c:03d}"] = self.total[p, c]
                channels[f"P{p}.direct.C{c:03d}"] = self.direct[p, c]
        for kind, images in (
            (PHASE, self.noise_rad),
            (AMPLITUDE, self.amplitude_noise),
            (CORRELATION, self.noise_correlation),
        ):
            if images is not None:
                for (f, p), name in noise_layers(self.scene, self.bases, kind).items():
                    channels[name] = images[f, p]
        return channels

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a transport file; raises `FileError` on anything but a whole one of this version."""
        with exr_rows.reading(path, KIND) as bands:
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
                scene = parse(str(meta["scene"]), where=str(path))
                identity = exr.identity_of(meta)
                limits = (
                    _phase_error(meta.get("phase_error")),
                    _render_noise(meta.get("render_noise")),
                )

                def view(scene: Scene, prefix: str = "", second: Self | None = None) -> Self:
                    kinds = (PHASE, AMPLITUDE, CORRELATION)
                    layers = [noise_layers(scene, bases, kind) for kind in kinds]
                    light, ambient, label, noise = _images(
                        bands, bases, layers, f"'{path}'", prefix
                    )
                    return cls(
                        light[0],
                        light[1],
                        ambient,
                        label,
                        tuple(str(label) for label in meta["labels"]),
                        bases,
                        scene,
                        int(meta["seed"]),
                        sampling.samples,
                        sampling.depth,
                        None if prefix else limits[0],
                        noise[0],
                        None if prefix else limits[1],
                        second,
                        noise[1],
                        noise[2],
                        identity,
                    )

                pair = scene.second_camera is not None
                return view(scene, second=view(scene.second_view(), SECOND) if pair else None)
            except (KeyError, TypeError, ValueError, SceneError) as error:
                raise FileError(
                    f"'{path}': its transport header or channels are damaged: {in_words(error)}"
                ) from error


def noise_layers(scene: Scene, bases: Sequence[Basis], kind: str) -> dict[tuple[int, int], str]:
    """Number of fringe and projector -> layer of this kind of the light paths' noise in a transport file."""
    fringes = finest_fringes(scene.patterns, bases)
    layers = {
        (f, p): f"P{p}.{kind}.{fringe.axis}"
        for f, fringe in enumerate(fringes)
        for p in range(len(bases))
    }
    if fringes:
        measuring = measuring_axis(scene, [fringe.axis for fringe in fringes])
        layers[measuring, 0] = kind
    return layers


def _images(
    bands: Bands,
    bases: Sequence[Basis],
    layers: Sequence[Mapping[tuple[int, int], str]],
    source: str,
    prefix: str = "",
) -> tuple[
    NDArray[np.float32], NDArray[np.float32], NDArray[np.uint16], list[NDArray[np.float32] | None]
]:
    """Light (total and direct, projector, channel, row, col), ambient light, labels, and noise of each kind, if there is any.

    All names start with `prefix`. Raises `KeyError` if one of the others is missing.
    """
    noise: list[NDArray[np.float32] | None] = [None for _ in layers]
    most = max(len(basis.channels) for basis in bases)
    ambient, label = np.empty((0, 0), np.float32), np.empty((0, 0), np.uint16)
    light: NDArray[Any] | None = None
    for rows, channels in bands:
        # A header may claim any size; a band that could be read confirms the width.
        if light is None:
            shape = (2, len(bases), most, *bands.size)
            light = mapped.array(shape, np.float32, source, "read it on a larger machine")
            ambient, label = np.empty(bands.size, np.float32), np.empty(bands.size, np.uint16)
        for images, kind in zip(light, ("total", "direct"), strict=True):
            for p, basis in enumerate(bases):
                images[p, len(basis.channels) :, rows] = 0.0
                for c in range(len(basis.channels)):
                    images[p, c, rows] = channels[f"{prefix}P{p}.{kind}.C{c:03d}"]
        ambient[rows] = channels[f"{prefix}ambient"]
        label[rows] = exr.whole(channels[f"{prefix}label"], np.uint16)
        for which, names in enumerate(layers):
            if names and all(prefix + name in channels for name in names.values()):
                known = noise[which]
                if known is None:
                    fringes = 1 + max(f for f, _ in names)
                    known = np.empty((fringes, len(bases), *bands.size), np.float32)
                    noise[which] = known
                for (f, p), name in names.items():
                    known[f, p, rows] = channels[prefix + name]
        mapped.release_pages(light)
    assert light is not None  # an image has a row
    return light, ambient, label, noise


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


def _render_noise(stored: dict[str, Any] | None) -> RenderNoise | None:
    if stored is None:
        return None
    reached = {
        str(label): None if ratio is None else float(ratio)
        for label, ratio in stored["reached"].items()
    }
    cut = {str(label): float(ratio) for label, ratio in stored.get("cut", {}).items()}
    return RenderNoise(float(stored["target"]), reached, int(stored["paths"]), cut)
