"""Stage 5, redistribution of E: pseudo-pressure (20) and shifts along the surface (Algorithm 5)."""

import warp as wp

from melp_warp.kernels.mls import SLOPE_BLUR, fit_height
from melp_warp.kernels.native import (
    Quadric,
    away_from_near,
    change_over_fit,
    gradient_row,
    solve_fit,
    sum_vectors,
    sum_within,
    vec5,
)
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.regions import balanced_load, part_range, region_parts, region_total
from melp_warp.kernels.sph import tangent_basis, tangential

wp.set_module_options({"enable_backward": False})

CLOSE = wp.constant(0.8)
"""Distance below which two E push each other apart, spacings."""

APART = wp.constant(0.2)
"""Share of what they lack that each goes in a step."""

OWN_REACH = wp.constant(0.6)
"""Shift up to which an E's own fit is good at the place moved to, spacings; beyond, that of the E nearest to it is."""

HOPS = wp.constant(4)
"""Rows of neighbours over which that one is looked for: shifts may be three times as many spacings long."""


@wp.kernel
def spread_chunks(density: wp.array(dtype=float), first: wp.array(dtype=wp.int32), part: wp.array(dtype=wp.vec4)):
    """Parts of (min delta, max delta, sum 1/delta, sum 1/delta^2)."""
    c = wp.tid()
    start, stop = part_range(c, first, part.shape[0])
    total = wp.vec4(1.0e30, 0.0, 0.0, 0.0)
    for i in range(start, stop):
        inverse = 1.0 / density[i]
        total = wp.vec4(
            wp.min(total[0], density[i]), wp.max(total[1], density[i]), total[2] + inverse, total[3] + inverse * inverse
        )
    part[c] = total


@wp.kernel
def summarize_spread_r(part: wp.array(dtype=wp.vec4), threshold: float, spread: wp.array(dtype=wp.vec3)):
    """For each region w = (delta_max - delta_min)/delta_mean, delta_mean, and how strongly E are to be shifted.

    That is 0 where w is below the threshold, and the square of w over the threshold beyond.
    """
    g = wp.tid()
    start, stop = region_parts(g, part.shape[0], spread.shape[0])
    low = float(1.0e30)
    high = float(0.0)
    s1 = float(0.0)
    s2 = float(0.0)
    for c in range(start, stop):
        p = part[c]
        low = wp.min(low, p[0])
        high = wp.max(high, p[1])
        s1 += p[2]
        s2 += p[3]
    mean = s1 / s2
    width = (high - low) / mean
    over = width / wp.max(threshold, 1.0e-6)
    spread[g] = wp.vec3(width, mean, wp.where(over > 1.0, over * over, 0.0))


@wp.kernel
def load_pressure_e(
    density: wp.array(dtype=float),
    region: wp.array(dtype=wp.int32),
    spread: wp.array(dtype=wp.vec3),
    # outputs
    b: wp.array(dtype=float),
    start: wp.array(dtype=float),
):
    """Right-hand side of (20), -lap_s C = (delta - mean)/delta times the area; zero where E are even enough. [n_e]."""
    i = wp.tid()
    d = density[i]
    s = spread[region[i]]
    b[i] = wp.where(s[2] > 0.0, (d - s[1]) / (d * d), 0.0)
    start[i] = 0.0


@wp.kernel
def balance_pressure_e(
    area: wp.array(dtype=float),
    region: wp.array(dtype=wp.int32),
    part: wp.array(dtype=wp.vec2),
    regions: int,
    # outputs
    b: wp.array(dtype=float),
):
    """Take from the load of (20) what it sums up to over a closed film: rounding of the mean, and no C belongs to it.

    Args:
        area: [n_e] m^2.
        region: [n_e].
        part: from `regions.load_chunks`.
        regions: number of regions.
        b: [n_e].
    """
    i = wp.tid()
    b[i] = balanced_load(b[i], area[i], part, region[i], regions)


@wp.func
def nearest_on_sheet(
    i: int, p: wp.vec3, x: wp.array(dtype=wp.vec3), normal: wp.array(dtype=wp.vec3), rows: Neighbors, limit: int
) -> int:
    """The E, below index `limit`, nearest to p on the same sheet: from i over ever nearer neighbours."""
    best = int(i)
    least = wp.length_sq(x[i] - p)
    for _ in range(HOPS):
        at = best
        for k in range(rows.start[at], rows.stop[at]):
            j = rows.index[k]
            if j < limit:
                away = wp.length_sq(x[j] - p)
                if away < least and wp.dot(normal[at], normal[j]) > 0.0:
                    best = j
                    least = away
    return best


@wp.kernel
def ask_shift_e(
    pressure: wp.array(dtype=float),
    x: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    spread: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    gradient: wp.array(dtype=wp.vec3),
    strength: float,
    spacing: float,
    limit: float,
    # outputs
    asked: wp.array(dtype=wp.vec3),
):
    """Shift -strength grad_s C that an E asks for, along its tangent plane.

    The smooth density of (9) hardly sees pairs, which form where a sheet is bent: E that are close are parted.

    Args:
        pressure: [n] C, m^2.
        x: [n] m.
        region: [n] region of each E.
        spread: see `summarize_spread_r`.
        normal: [n] unit normals.
        rows: E:E neighbours.
        gradient: [pairs] gradient weights, 1/m.
        strength: beta at the threshold, 0 to 1: it grows with the square of the spread, up to 1.
        spacing: of the E, m.
        limit: largest shift, m.
        asked: [n_e] m.
    """
    i = rows.first + wp.tid()
    n = normal[i]
    shift = wp.vec3()
    asking = spread[region[i]][2]
    if asking > 0.0:
        beta = wp.min(strength * asking, 1.0)
        shift = -beta * tangential(gradient_row(i, pressure, rows, gradient, pressure.shape[0]), n)
        shift += beta * APART * tangential(away_from_near(i, x, normal, rows, CLOSE * spacing), n)
    size = wp.length(shift)
    if size > 0.0:
        shift = shift * wp.min(limit / size, 1.0)
    asked[i] = shift


@wp.kernel
def smooth_far_e(
    asked: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    near: wp.array(dtype=float),
    rows: Neighbors,
    spacing: float,
    # outputs
    shift: wp.array(dtype=wp.vec3),
):
    """E that go far go as those around them do; others go as they ask.

    Where E are sparse the gradient of C is the larger. With shifts of several spacings sparse places so run into the
    dense ones ahead of them, and waves of a few spacings steepen until E are in no order.

    Args:
        asked: [n_e] m.
        normal: [n] unit normals.
        near: [pairs] W of each pair, 1/m^2.
        rows: E:E neighbours.
        spacing: of the E, m.
        shift: [n_e] m.
    """
    i = rows.first + wp.tid()
    own = asked[i]
    if wp.length(own) > OWN_REACH * spacing:
        total = sum_within(i, near, rows, asked.shape[0])
        own = tangential(sum_vectors(i, near, asked, rows, asked.shape[0]), normal[i]) / wp.max(total, 1.0e-30)
    shift[i] = own


@wp.kernel
def spread_layer_e(
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    area: wp.array(dtype=float),
    # outputs
    layer: wp.array(dtype=wp.vec3),
):
    """Liquid and surfactant on a unit of area, kg/m^2 and mol/m^2, and a third part that is 0. [n_e]."""
    i = wp.tid()
    layer[i] = wp.vec3(mass[i], surfactant[i], 0.0) / area[i]


@wp.kernel
def sharpen_fields_e(
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    u_mid: wp.array(dtype=float),
    layer: wp.array(dtype=wp.vec3),
    surface: wp.array(dtype=Quadric),
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    spread: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    # outputs
    sharp: wp.array(dtype=wp.vec3),
    sharp_mid: wp.array(dtype=float),
    bend: wp.array(dtype=float),
    sharp_layer: wp.array(dtype=wp.vec3),
):
    """Fields f - b lap_s f, whose quadratic fits change over a shift as the fields f themselves do.

    The slope of a quadratic that is fitted to a cubic lacks b grad_s lap_s f, b = `SLOPE_BLUR` (r/3)^2: what it finds
    lags behind the shift, velocity, shape and liquid each by another share. The second derivatives take the same
    addition: with a sharper slope alone shifts would make short waves larger. Nothing is found where no E is shifted.

    Args:
        x: [n] m.
        u: [n] m/s.
        u_mid: [n_e] m/s.
        layer: [n_e] see `spread_layer_e`; null where L have the liquid.
        surface: [n_e] fitted surfaces.
        normal: [n] unit normals.
        region: [n] region of each E.
        spread: see `summarize_spread_r`.
        rows: E:E neighbours.
        r: support radius, m.
        sharp: [n_e] of velocities, m/s.
        sharp_mid: [n_e] of normal speeds, m/s.
        bend: [n_e] of heights, less these themselves: -b kappa, m.
        sharp_layer: [n_e] of the layers; null likewise.
    """
    i = rows.first + wp.tid()
    if spread[region[i]][2] > 0.0:
        h = r / 3.0
        n = normal[i]
        e1, e2 = tangent_basis(n)
        factor, _c = fit_height(i, x, n, rows, r, x.shape[0], False)
        y = solve_fit(factor, vec5(0.0, 0.0, 2.0, 0.0, 2.0))
        lap = change_over_fit(i, x, e1, e2, y, rows, r, u_mid.shape[0], u, u_mid)
        sharp[i] = u[i] - SLOPE_BLUR * wp.vec3(lap[0], lap[1], lap[2])
        sharp_mid[i] = u_mid[i] - SLOPE_BLUR * lap[3]
        bend[i] = -SLOPE_BLUR * h * h * 2.0 * wp.trace(surface[i].second)
        if layer:
            more = change_over_fit(i, x, e1, e2, y, rows, r, u_mid.shape[0], layer, u_mid)
            sharp_layer[i] = layer[i] - SLOPE_BLUR * wp.vec3(more[0], more[1], more[2])


@wp.kernel
def shift_e(
    shifts: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    u_mid: wp.array(dtype=float),
    sharp: wp.array(dtype=wp.vec3),
    sharp_mid: wp.array(dtype=float),
    bend: wp.array(dtype=float),
    layer: wp.array(dtype=wp.vec3),
    sharp_layer: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    r: float,
    spacing: float,
    # outputs
    x_new: wp.array(dtype=wp.vec3),
    u_new: wp.array(dtype=wp.vec3),
    u_mid_new: wp.array(dtype=float),
    layer_new: wp.array(dtype=wp.vec3),
):
    """Shift E along the fitted surface; surface and velocities stay where they are in space.

    Both are found at the new place by the same quadratic fit. A linear one, u + s.grad u, would make every wave
    exp(ikx) larger by k^2 s^2/2; the fit's quadratic part takes that away, and a little of the shortest waves. The fit
    is that of the E itself or, where it goes far, of the one that it comes nearest to.

    Args:
        shifts: [n_e] m.
        x: [n] m.
        u: [n] material velocity, m/s.
        u_mid: [n_e] normal speed that moves E in this step, m/s.
        sharp: [n_e] velocity whose fit tells how it changes, see `sharpen_fields_e`, m/s.
        sharp_mid: [n_e] the same of the normal speed, m/s.
        bend: [n_e] the same of heights, beyond these themselves, m; null where nothing is sharpened.
        layer: [n_e] see `spread_layer_e`; null where the liquid is not found here.
        sharp_layer: [n_e] the layer whose fit tells how it changes; null likewise.
        normal: [n] unit normals.
        rows: E:E neighbours.
        r: support radius, m.
        spacing: of the E, m.
        x_new: [n_e] m.
        u_new: [n_e] velocity at the place moved to, m/s.
        u_mid_new: [n_e] normal speed there, m/s.
        layer_new: [n_e] liquid and surfactant there, kg/m^2 and mol/m^2.
    """
    i = rows.first + wp.tid()
    n = normal[i]
    shift = shifts[i]
    size = wp.length(shift)
    of = int(i)
    p = x[i]
    v = u[i]
    speed = u_mid[i]
    more = wp.vec4()
    if size > 0.0:
        if size > OWN_REACH * spacing:
            of = nearest_on_sheet(i, p + shift, x, normal, rows, u_mid.shape[0])
            n = normal[of]
            shift = tangential(p + shift - x[of], n)
            p = x[of]
            v = u[of]
            speed = u_mid[of]
        e1, e2 = tangent_basis(n)
        factor, c = fit_height(of, x, n, rows, r, x.shape[0], False)
        h = r / 3.0
        a = wp.dot(shift, e1) / h
        b = wp.dot(shift, e2) / h
        way = vec5(a, b, a * a, a * b, b * b)
        y = solve_fit(factor, way)
        p += shift + h * wp.dot(c, way) * n
        if layer:
            more = change_over_fit(of, x, e1, e2, y, rows, r, u_mid.shape[0], sharp_layer, bend)
            p += more[3] * n
        elif bend:
            p += change_over_fit(of, x, e1, e2, y, rows, r, u_mid.shape[0], sharp, bend)[3] * n
        change = change_over_fit(of, x, e1, e2, y, rows, r, u_mid.shape[0], sharp, sharp_mid)
        v += wp.vec3(change[0], change[1], change[2])
        speed += change[3]
    if layer:
        layer_new[i] = layer[of] + wp.vec3(more[0], more[1], more[2])
    x_new[i] = p
    u_new[i] = v
    u_mid_new[i] = speed


@wp.func
def on_one_side(taken: wp.array(dtype=wp.int32), i: int, j: int) -> bool:
    """Whether no free rim lies between two E."""
    same = bool(True)
    if taken:
        same = taken[i] == taken[j]
    return same


@wp.kernel
def sweep_liquid_e(
    x: wp.array(dtype=wp.vec3),
    moved: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    weight: wp.array(dtype=float),
    rows: Neighbors,
    n_e: int,
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    taken: wp.array(dtype=wp.int32),
    # outputs
    swept: wp.array(dtype=wp.vec2),
):
    """What the borders of the cells sweep as E of a film of E alone are shifted: it goes from one E to the other.

    Pair by pair, so that none is lost: m_ij = w_ij eta_ij s.d, s the mean shift of both and d the way from one to the
    other, which is the swept area of (20) where s = -grad C. eta_ij is that in the middle of what is swept.

    Args:
        x: [n] m.
        moved: [n_e] places shifted to, m.
        area: [n_e] m^2.
        weight: [pairs] a_i a_j K_ij.
        rows: E:E neighbours.
        n_e: number of E.
        mass: [n_e] kg.
        surfactant: [n_e] mol.
        taken: [n_e] 1 for E whose liquid a free rim has; none goes from or to them. None where nothing bursts.
        swept: [n_e] mass and surfactant that each E gets, kg and mol.
    """
    i = rows.first + wp.tid()
    own = moved[i] - x[i]
    liquid = wp.vec2(mass[i], surfactant[i])
    layer = liquid / area[i]
    total = wp.vec2()
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < n_e and on_one_side(taken, i, j):
            d = x[j] - x[i]
            way = 0.5 * wp.dot(own + moved[j] - x[j], d)
            other = wp.vec2(mass[j], surfactant[j]) / area[j]
            ahead = 2.0 / 3.0 * way / wp.max(wp.length_sq(d), 1.0e-30)
            total += weight[k] * way * (0.5 * (layer + other) + ahead * (other - layer))
    swept[i] = total


@wp.kernel
def blur_swept_e(
    swept: wp.array(dtype=wp.vec2),
    area: wp.array(dtype=float),
    near: wp.array(dtype=float),
    rows: Neighbors,
    n_e: int,
    taken: wp.array(dtype=wp.int32),
    # outputs
    blurred: wp.array(dtype=wp.vec2),
):
    """Mean of what is swept over the neighbours, as control areas are means of cells; its sum stays.

    Args:
        swept: [n_e] kg and mol.
        area: [n_e] m^2.
        near: [pairs] W of each pair, 1/m^2.
        rows: E:E neighbours.
        n_e: number of E.
        taken: see `sweep_liquid_e`.
        blurred: [n_e] kg and mol.
    """
    i = rows.first + wp.tid()
    total = swept[i]
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < n_e and on_one_side(taken, i, j):
            total += near[k] * (area[i] * swept[j] - area[j] * swept[i])
    blurred[i] = total


@wp.kernel
def take_swept_e(
    swept: wp.array(dtype=wp.vec2),
    # outputs
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
):
    """Give E what they get, kg and mol: their liquid stays where it is. [n_e]."""
    i = wp.tid()
    mass[i] = mass[i] + swept[i][0]
    surfactant[i] = surfactant[i] + swept[i][1]


@wp.kernel
def ask_layers(
    spread: wp.array(dtype=wp.vec3),
    # outputs
    go: wp.array(dtype=int),
):
    """1 where E of the one film were shifted, so that each stands for other liquid; 0 where none were."""
    go[0] = wp.where(spread[0][2] > 0.0, 1, 0)


@wp.kernel
def sum_layers_chunks(
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    layer: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    first: wp.array(dtype=wp.int32),
    # outputs
    part: wp.array(dtype=wp.vec4d),
):
    """Parts of liquid and surfactant that E have, and of what they would have with their new layers and areas.

    Args:
        mass: [n_e] kg.
        surfactant: [n_e] mol on one interface.
        layer: [n_e] liquid and surfactant at the places shifted to, kg/m^2 and mol/m^2.
        area: [n_e] areas there, m^2.
        first: see `part_range`.
        part: parts.
    """
    c = wp.tid()
    start, stop = part_range(c, first, part.shape[0])
    total = wp.vec4d()
    for i in range(start, stop):
        new = layer[i] * area[i]
        total += wp.vec4d(wp.float64(mass[i]), wp.float64(surfactant[i]), wp.float64(new[0]), wp.float64(new[1]))
    part[c] = total


@wp.func
def scaled(amount: float, old: wp.float64, new: wp.float64) -> float:
    """An amount of those that sum up to `new`, as a share of `old`."""
    share = wp.float64(1.0)
    if new > wp.float64(0.0):
        share = old / new
    return float(wp.float64(amount) * share)


@wp.kernel
def fill_layers_e(
    layer: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    part: wp.array(dtype=wp.vec4d),
    go: wp.array(dtype=int),
    # outputs
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
):
    """Give E the liquid of their new places, scaled so that none is made or lost.

    Args:
        layer: [n_e] liquid and surfactant there, kg/m^2 and mol/m^2.
        area: [n_e] areas there, m^2.
        part: from `sum_layers_chunks`.
        go: [1] 1 where E were shifted.
        mass: [n_e] kg.
        surfactant: [n_e] mol on one interface.
    """
    i = wp.tid()
    if go[0] == 1:
        total = region_total(part, 0, 1)
        new = layer[i] * area[i]
        mass[i] = scaled(new[0], total[0], total[2])
        surfactant[i] = scaled(new[1], total[1], total[3])
