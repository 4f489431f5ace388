"""Normals for smooth shading, the same bits in every run.

Mitsuba can compute them, but adds up the triangles' shares in the order in which its threads finish: the last bits, and
with them the light on smooth surfaces, would differ between runs.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def vertex_normals(vertices: Floats, faces: NDArray[np.int64]) -> Floats:
    """Unit normals (vertex, 3): the means of the triangles' normals, weighted by their angles; (0, 0, 1) without such a
    triangle.

    G. Thuermer and C. A. Wuethrich, Computing Vertex Normals from Polygonal Facets, J. Graphics Tools 3(1), 1998.
    """
    corners = np.asarray(vertices, np.float64)[faces]
    edges = np.roll(corners, -1, axis=1) - corners
    area = np.cross(edges[:, 0], edges[:, 1])
    # arctan2 of twice the triangle's area and the dot product of two sides is exact near 0 and near pi.
    doubled = np.linalg.norm(area, axis=1)
    normal = area / np.where(doubled > 0.0, doubled, 1.0)[:, None]
    cosine = -np.einsum("fci,fci->fc", edges, np.roll(edges, 1, axis=1))
    angle = np.arctan2(doubled[:, None], cosine)
    at = np.asarray(faces).ravel()
    sums = np.stack(
        [np.bincount(at, (angle * normal[:, None, i]).ravel(), len(vertices)) for i in range(3)],
        axis=-1,
    )
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    unit: Floats = np.where(length > 0.0, sums / np.where(length > 0.0, length, 1.0), (0, 0, 1))
    return unit
