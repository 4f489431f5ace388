"""Any patterns as combinations of traced ones: what `render.expose` may show without tracing again."""

import numpy as np

from render.sensor_stages import Floats
from render.transport import Transport
from scenes.acquisition.pattern_basis import AXES, RANK_TOLERANCE, Basis, basis, bit_planes
from scenes.acquisition.patterns import Patterns
from scenes.support.errors import RenderError

# A pattern's relative residue outside the traced basis that is no more than the rounding which the basis leaves out.
RESIDUE = 10 * RANK_TOLERANCE


def channel_weights(transport: Transport, projector: int, patterns: Patterns) -> Floats:
    """Weights (frame, channel) that make the patterns of one projector from its traced channels.

    Raises `RenderError` for patterns outside the span of the traced ones.
    """
    traced = transport.bases[projector]
    if patterns == transport.scene.patterns:
        return traced.weights
    device = transport.scene.projectors[projector]
    wanted = basis(patterns, device, device.resolution)
    weights: Floats = wanted.weights @ _in_terms_of(traced, wanted)
    for i, frame in enumerate(patterns.frames()):
        missing = _missing(wanted, traced, wanted.weights[i], weights[i])
        if missing:
            raise RenderError(
                f"projector {projector} cannot show frame {i} ({frame.kind}, {frame.axis}, {frame.period_px:g} px, "
                f"step {frame.step}): it needs {missing}, which was not traced (traced: {_names(traced)}); "
                "trace the scene again with these patterns"
            )
    return weights


def plane_weights(transport: Transport, projector: int, patterns: Patterns) -> list[Floats]:
    """Weights (plane, channel) of each frame's bit planes from the traced channels; (0, channel) if it is steady.

    Raises `RenderError` for planes outside the span of the traced ones.
    """
    device = transport.scene.projectors[projector]
    channels = transport.bases[projector].channels
    if device.frame_ms is None:
        return [np.zeros((0, len(channels)))] * len(patterns.frames())
    found = []
    on = {axis: [c.kind == "table" and c.axis == axis for c in channels] for axis in AXES}
    # Tuples become arrays slowly: once for each axis.
    traced = {
        axis: np.array([c.values for c, here in zip(channels, on[axis], strict=True) if here])
        for axis in AXES
    }
    for i, frame in enumerate(patterns.frames()):
        tables, here = traced[frame.axis], on[frame.axis]
        planes = bit_planes(patterns, frame, device, device.resolution)
        fits = tables.ndim == 2 and tables.shape[1] == planes.shape[1]
        weights = np.zeros((len(planes), len(channels)))
        if fits:
            # Tables of one axis are orthogonal, and their mean square is 1.
            weights[:, here] = planes @ tables.T / tables.shape[1]
        left = planes - weights[:, here] @ tables if fits else planes
        if np.linalg.norm(left) > RESIDUE * np.linalg.norm(planes):
            raise RenderError(
                f"projector {projector} cannot show the bit planes of frame {i}, which were not traced: trace the scene "
                "again with these patterns"
            )
        found.append(weights)
    return found


def _in_terms_of(traced: Basis, wanted: Basis) -> Floats:
    """Each wanted channel as a combination of traced ones, (wanted, traced): least squares for tables."""
    terms = np.zeros((len(wanted.channels), len(traced.channels)))
    for i, want in enumerate(wanted.channels):
        for j, have in enumerate(traced.channels):
            if want.kind == have.kind == "table" and want.axis == have.axis:
                # Tables of one axis are orthogonal, and their mean square is 1.
                terms[i, j] = np.mean(np.multiply(want.values, have.values))
            else:
                terms[i, j] = want == have
    return terms


def _missing(wanted: Basis, traced: Basis, asked: Floats, made: Floats) -> str:
    """What the traced channels lack of a frame, in words; empty if nothing."""
    for channel, weight in zip(wanted.channels, asked, strict=True):
        if weight and channel.kind != "table" and channel not in traced.channels:
            return f"channel '{channel.name}'"
    ask, make = _table(wanted, asked), _table(traced, made)
    if np.linalg.norm(ask - make) > RESIDUE * np.linalg.norm(ask):
        return "a table of projector pixels outside the span of the traced ones"
    return ""


def _table(basis: Basis, weights: Floats) -> Floats:
    """The part of a frame's emitted projector pixels that tables make."""
    terms = [
        weight * np.array(channel.values)
        for channel, weight in zip(basis.channels, weights, strict=True)
        if channel.kind == "table" and weight
    ]
    return np.sum(terms, axis=0) if terms else np.zeros(1)


def _names(basis: Basis) -> str:
    tables = sum(channel.kind == "table" for channel in basis.channels)
    names = [channel.name for channel in basis.channels if channel.kind != "table"]
    return ", ".join(names + ([f"{tables} tables of pixels"] if tables else []))
