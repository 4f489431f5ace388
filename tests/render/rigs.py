"""Small scenes for the light-transport tests: a rig of each model, and objects of each material, within 60 mm."""

from typing import Any

from scenes import Scene

Entries = dict[str, Any]

# A strong wide-angle distortion: 20 px of 640 at the corners.
DISTORTION = (-0.12, 0.05, 0.002, -0.001, 0.01)


def pinhole(
    resolution: tuple[int, int] = (24, 18),
    field_mm: float = 60.0,
    x_mm: float = 0.0,
    height_mm: float = 200.0,
    **more: Any,
) -> Entries:
    """A pinhole device that sees about `field_mm` of the plane z = 0 across its width."""
    focal = resolution[0] * height_mm / field_mm
    return {
        "model": "pinhole",
        "resolution": resolution,
        "fx_px": focal,
        "fy_px": focal,
        "cx_px": resolution[0] / 2,
        "cy_px": resolution[1] / 2,
        "pose": {"origin_mm": (x_mm, 0.0, height_mm)},
        **more,
    }


def telecentric(
    resolution: tuple[int, int] = (24, 18), field_mm: float = 60.0, x_mm: float = 0.0, **more: Any
) -> Entries:
    """A telecentric device 200 mm above the plane, seeing `field_mm` across its width."""
    return {
        "model": "telecentric",
        "resolution": resolution,
        "field_width_mm": field_mm,
        "pose": {"origin_mm": (x_mm, 0.0, 200.0)},
        **more,
    }


def pinhole_projector(**more: Any) -> Entries:
    """A pinhole projector 80 mm to the left that covers the camera's field."""
    return pinhole(
        **{"resolution": (128, 96), "field_mm": 72.0, "x_mm": -80.0, "reference_mm": 200.0, **more}
    )


def telecentric_projector(**more: Any) -> Entries:
    """A telecentric projector tilted by 22 degrees that covers the camera's field."""
    return telecentric(**{"resolution": (128, 96), "field_mm": 72.0, "x_mm": -80.0, **more})


def plane(material: str = "white-paint") -> list[Entries]:
    """A plate at z = 0, larger than any field here."""
    shape = {"kind": "plate", "size_mm": (200.0, 160.0)}
    return [{"label": "base", "material": material, "shape": shape}]


def board(metal: str = "solder") -> list[Entries]:
    """Cap, step, black ink and a metal cap on a plate."""
    cap = {"kind": "cap", "rings": 12, "segments": 32}
    return [
        *plane(),
        {
            "label": "cap",
            "material": "grey-paint",
            "position_mm": (-12.0, 6.0, 0.0),
            "shape": {**cap, "radius_mm": 10.0, "height_mm": 6.0},
        },
        {
            "label": "step",
            "material": "white-paint",
            "position_mm": (16.0, 4.0, 0.0),
            "shape": {"kind": "box", "size_mm": (12.0, 16.0, 5.0)},
        },
        {
            "label": "ink",
            "material": "black-ink",
            "position_mm": (0.0, -14.0, 0.05),
            "shape": {"kind": "disk", "radius_mm": 6.0},
        },
        {
            "label": "solder",
            "material": metal,
            "smooth": True,
            "position_mm": (-18.0, -12.0, 0.0),
            "shape": {**cap, "radius_mm": 6.0, "height_mm": 3.0},
        },
    ]


def groove() -> list[Entries]:
    """Two white plates that face each other at 100 degrees: light is reflected between them again and again."""
    shape = {"kind": "plate", "size_mm": (52.0, 100.0)}
    return [
        {
            "label": "left",
            "material": "white-paint",
            "position_mm": (-20.0, 0.0, 0.0),
            "rotation_deg": (0.0, 40.0, 0.0),
            "shape": shape,
        },
        {
            "label": "right",
            "material": "white-paint",
            "position_mm": (20.0, 0.0, 0.0),
            "rotation_deg": (0.0, -40.0, 0.0),
            "shape": shape,
        },
    ]


def resin() -> list[Entries]:
    """A clear block with a rough skin on the plate: light goes in, meets the paint below, and comes out elsewhere."""
    block = {"kind": "box", "size_mm": (30.0, 24.0, 6.0)}
    return [*plane(), {"label": "resin", "material": "resin", "shape": block}]


def scene(
    camera: Entries,
    *projectors: Entries,
    objects: list[Entries] | None = None,
    depth: int = 3,
    ambient: float = 0.0,
    patterns: Entries | None = None,
) -> Scene:
    """A scene of these; three-step patterns of 16 px by default."""
    return Scene.model_validate(
        {
            "camera": camera,
            "projectors": projectors,
            "objects": objects or board(),
            "materials": {
                "mirror": {"kind": "conductor", "eta": 1.48, "k": 5.25, "roughness": 0.0}
            },
            "ambient": {"radiance_w_m2_sr": ambient},
            "patterns": {
                "kind": "phase-shift",
                "periods_px": (16.0,),
                "steps": 3,
                **(patterns or {}),
            },
            "exposures": {"times_ms": (1.0,)},
            "sampling": {"samples": 64, "depth": depth},
            "height_range_mm": (-1.0, 9.0),
        }
    )
