"""Ground truth: what the camera should have measured, from rays through pixel centres against the meshes."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from scenes.files import exr
from scenes.support.errors import FileError, ScoreError, nearest
from scenes.support.notebook import Displayed, PreviewPlane
from scenes.support.validation_words import in_words

KIND = "truth"
Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False, repr=False)
class Truth(Displayed):
    """Ground truth maps of all camera pixels.

    Where the pixel's ray meets nothing, floats are NaN, `label` is 0 and `lit` False.
    """

    xyz_mm: Floats
    """(row, col, 3) world point."""
    normal: Floats
    """(row, col, 3) unit normal, facing the camera: the triangle's; with a screen that of the shading."""
    label: NDArray[np.uint16]
    """(row, col) index into `labels` plus 1; 0: nothing."""
    labels: tuple[str, ...]
    lit_by: NDArray[np.bool_]
    """(projector, row, col): the projector's light reaches the point unblocked and from the seen side; of a pair of cameras,
    the second one sees the point, too."""
    columns_px: Floats
    """(projector, row, col) continuous projector column of the point, lit or not."""
    rows_px: Floats
    """(projector, row, col) continuous projector row of the point."""
    direct_fractions: Floats
    """(projector, row, col) share of direct light in the white-pattern radiance, [0, 1]; NaN where dark."""
    scene: str = ""
    """TOML of the scene."""
    pad: NDArray[np.uint32] | None = None
    """(row, col) id of the board's pad that the paste, or the bare copper, belongs to; 0 none. None: no board."""
    material: NDArray[np.uint16] | None = None
    """(row, col) index into `materials` plus 1; 0 is nothing."""
    materials: tuple[str, ...] = ()
    render_noise_mm: Floats | None = None
    """(row, col) standard deviation that the noise of light paths alone gives the height, mm; None: not known."""
    identity: exr.Identity = field(default_factory=dict)
    """Digests of the scene and rig, see `scenes.scene_identity`; empty: not known."""

    def _facts(self) -> dict[str, str]:
        rows, columns = self.label.shape
        return {"size": f"{columns} x {rows} px", "labels": " ".join(self.labels)}

    def _planes(self) -> list[PreviewPlane]:
        return [
            PreviewPlane("True height", "mm", self.height_mm),
            PreviewPlane("Label", "", self.label, self.labels),
        ]

    @property
    def height_mm(self) -> Floats:
        """(row, col) world z of the point, mm."""
        return self.xyz_mm[..., 2]

    @property
    def lit(self) -> NDArray[np.bool_]:
        """(row, col): at least one projector's light reaches the point."""
        return np.asarray(self.lit_by.any(axis=0), dtype=np.bool_)

    @property
    def column_px(self) -> Floats:
        """(row, col) continuous column of the first projector."""
        first: Floats = self.columns_px[0]
        return first

    @property
    def row_px(self) -> Floats:
        """(row, col) continuous row of the first projector."""
        first: Floats = self.rows_px[0]
        return first

    @property
    def direct_fraction(self) -> Floats:
        """(row, col) share of direct light, of the first projector."""
        first: Floats = self.direct_fractions[0]
        return first

    def region(self, label: str) -> NDArray[np.bool_]:
        """Mask of one label.

        Parameters
        ----------
        label
            A label of the scene.

        Returns
        -------
        ndarray of bool, (row, col)
            True where the pixel has this label.

        Raises
        ------
        ScoreError
            The scene does not have this label.
        """
        if label not in self.labels:
            raise ScoreError(f"truth has no label '{label}': {nearest(label, self.labels)}")
        mask: NDArray[np.bool_] = self.label == self.labels.index(label) + 1
        return mask

    def write(self, path: str | Path) -> None:
        """Write as EXR: ``xyz.X Y Z``, ``N.X Y Z``, ``label``, and per projector ``P0.lit P0.column ...``."""
        channels: dict[str, NDArray[Any]] = {"label": self.label.astype(np.uint32)}
        for name, ids in (("pad", self.pad), ("material", self.material)):
            if ids is not None:
                channels[name] = ids.astype(np.uint32)
        if self.render_noise_mm is not None:
            channels["render_noise"] = self.render_noise_mm
        for i, axis in enumerate("XYZ"):
            channels[f"xyz.{axis}"] = self.xyz_mm[..., i]
            channels[f"N.{axis}"] = self.normal[..., i]
        for p in range(len(self.lit_by)):
            channels[f"P{p}.lit"] = self.lit_by[p].astype(np.float16)
            channels[f"P{p}.column"] = self.columns_px[p]
            channels[f"P{p}.row"] = self.rows_px[p]
            channels[f"P{p}.direct"] = self.direct_fractions[p]
        meta = {
            "units": {
                "xyz": "mm",
                "N": "1",
                "column": "projector px",
                "row": "projector px",
                "direct": "1",
                "render_noise": "mm",
            },
            "labels": list(self.labels),
            "materials": list(self.materials),
            "projectors": len(self.lit_by),
            "scene": self.scene,
            "identity": dict(self.identity),
        }
        exr.write(path, KIND, channels, meta)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a truth file; raises `FileError` for anything but a complete one of this version."""
        channels, meta = exr.read(path, KIND)
        try:
            projectors = range(int(meta["projectors"]))
            return cls(
                np.stack([channels[f"xyz.{axis}"] for axis in "XYZ"], axis=-1),
                np.stack([channels[f"N.{axis}"] for axis in "XYZ"], axis=-1),
                exr.whole(channels["label"], np.uint16),
                tuple(str(label) for label in meta["labels"]),
                np.stack([channels[f"P{p}.lit"] > 0.5 for p in projectors]),
                np.stack([channels[f"P{p}.column"] for p in projectors]),
                np.stack([channels[f"P{p}.row"] for p in projectors]),
                np.stack([channels[f"P{p}.direct"] for p in projectors]),
                str(meta["scene"]),
                exr.whole(channels["pad"], np.uint32) if "pad" in channels else None,
                exr.whole(channels["material"], np.uint16) if "material" in channels else None,
                tuple(str(name) for name in meta.get("materials", ())),
                channels.get("render_noise"),
                exr.identity_of(meta),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise FileError(
                f"'{path}': its truth header or channels are damaged: {in_words(error)}"
            ) from error
