"""Structured meshes of 6-node triangles: corneal arcs, tubes, shells and blocks."""

import numpy as np

from palpate.workers.organs.cornea.section_mesh import T6Mesh


def mapped(nodes_mm, cells_along, cells_across):
    """Return two triangles per cell of a lattice of nodes, (2 a + 1, 2 c + 1, 2)."""
    number = np.arange(nodes_mm.shape[0] * nodes_mm.shape[1]).reshape(nodes_mm.shape[:2])
    triangles = []
    for i in range(0, 2 * cells_along, 2):
        for j in range(0, 2 * cells_across, 2):
            n = number[i : i + 3, j : j + 3]
            if (i + j) // 2 % 2 == 0:
                triangles.append([n[0, 0], n[2, 0], n[2, 2], n[1, 0], n[2, 1], n[1, 1]])
                triangles.append([n[0, 0], n[2, 2], n[0, 2], n[1, 1], n[1, 2], n[0, 1]])
            else:
                triangles.append([n[0, 0], n[2, 0], n[0, 2], n[1, 0], n[1, 1], n[0, 1]])
                triangles.append([n[2, 0], n[2, 2], n[0, 2], n[2, 1], n[1, 2], n[1, 1]])
    return T6Mesh(
        nodes_mm=nodes_mm.reshape(-1, 2),
        triangles=np.array(triangles, dtype=np.int32),
        anterior=number[:, -1].astype(np.int32),
        posterior=number[:, 0].astype(np.int32),
        left=number[0].astype(np.int32),
        right=number[-1].astype(np.int32),
    )


def corneal_arc(
    cells_along=120,
    cells_across=4,
    radius_mm=7.8,
    chord_mm=11.7,
    thickness_mm=(0.595, 0.70),
    at_x_mm=(),
):
    """Return the section of the inventory, with the nearest surface corner moved to each x."""
    edge = np.arcsin(chord_mm / 2 / radius_mm)
    angle = np.linspace(-edge, edge, cells_along + 1)
    for x in at_x_mm:
        wanted = np.arcsin(x / radius_mm)
        angle[np.argmin(np.abs(angle - wanted))] = wanted
    angle = np.interp(np.arange(2 * cells_along + 1) / 2, np.arange(cells_along + 1), angle)
    T, S = np.meshgrid(angle, np.linspace(0, 1, 2 * cells_across + 1), indexing="ij")
    thickness = thickness_mm[0] + (thickness_mm[1] - thickness_mm[0]) * (T / edge) ** 2
    r = radius_mm - thickness * (1 - S)
    x = r * np.sin(T)
    x[np.abs(x) < 1e-12] = 0.0
    return mapped(np.stack([x, r * np.cos(T)], -1), cells_along, cells_across)
