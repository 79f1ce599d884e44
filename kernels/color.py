"""Interference colour by table look-up."""

import warp as wp


@wp.func
def film_color(
    table: wp.array2d[wp.vec3],
    max_thickness: float,
    thickness: float,
    cos_theta: float,
) -> wp.vec3:
    """Linear sRGB of gain 1 of the light that a film reflects, bilinear in `melp_warp.optics.color_table`.

    Args:
        table: colours [n_thickness, n_cos], thickness 0..max_thickness and cosine 0..1, uniform.
        max_thickness: thickness of the last row, nm.
        thickness: film thickness, nm; held to 0..max_thickness.
        cos_theta: cosine of the angle of incidence in air; its sign is ignored, it is held to 0..1.
    """
    rows = table.shape[0]
    columns = table.shape[1]
    u = wp.clamp(thickness / max_thickness, 0.0, 1.0) * float(rows - 1)
    v = wp.min(wp.abs(cos_theta), 1.0) * float(columns - 1)
    i = wp.min(int(u), rows - 2)
    j = wp.min(int(v), columns - 2)
    a = u - float(i)
    b = v - float(j)
    low = (1.0 - b) * table[i, j] + b * table[i, j + 1]
    high = (1.0 - b) * table[i + 1, j] + b * table[i + 1, j + 1]
    return (1.0 - a) * low + a * high
