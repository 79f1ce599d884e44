"""Sums and extremes over the particles, in float64 parts, for the run's log and its guards."""

import warp as wp

from melp_warp.kernels.gas import AREA
from melp_warp.kernels.regions import part_range, part_region

wp.set_module_options({"enable_backward": False})

vec6d = wp.types.vector(length=6, dtype=wp.float64)
vec12d = wp.types.vector(length=12, dtype=wp.float64)


@wp.kernel
def summarize_chunks(
    mass: wp.array(dtype=float),
    surfactant: wp.array(dtype=float),
    u: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    eta: wp.array(dtype=float),
    density: float,
    n: int,
    # outputs
    part: wp.array(dtype=vec12d),
):
    """Parts of the sums and extremes of a particle set.

    Slots: 0 mass, 1 surfactant, 2-4 momentum, 5 kinetic energy, 6 max speed^2, 7 min eta, 8 max eta, 9 sum eta a,
    10 sum a, 11 sum eta^2 a, with the area a = m/(rho eta). Particles without mass are not there.

    Args:
        mass: [n] kg.
        surfactant: [n] mol.
        u: [n] velocity that carries the momentum, m/s.
        v: [n] velocity of the particles, m/s.
        eta: [n] m.
        density: rho, kg/m^3.
        n: number of particles.
        part: parts.
    """
    c = wp.tid()
    size = (n + part.shape[0] - 1) // part.shape[0]
    s = vec12d()
    s[7] = wp.float64(1.0e30)
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        m = wp.float64(mass[i])
        p = u[i]
        vv = wp.float64(wp.length_sq(v[i]))
        h = wp.float64(eta[i])
        a = m / (wp.float64(density) * h)
        s[0] += m
        s[1] += wp.float64(surfactant[i])
        s[2] += m * wp.float64(p[0])
        s[3] += m * wp.float64(p[1])
        s[4] += m * wp.float64(p[2])
        s[5] += wp.float64(0.5) * m * vv
        if mass[i] > 0.0:
            s[6] = wp.max(s[6], vv)
            s[7] = wp.min(s[7], h)
            s[8] = wp.max(s[8], h)
        s[9] += h * a
        s[10] += a
        s[11] += h * h * a
    part[c] = s


@wp.kernel
def energy_chunks(
    area: wp.array(dtype=float),
    gamma: wp.array(dtype=float),
    region: wp.array(dtype=wp.int32),
    tension: wp.array(dtype=float),
    slope: float,
    cover: wp.array(dtype=float),
    n: int,
    part: wp.array(dtype=wp.float64),
):
    """Parts of the surface energy sigma (2 - c) a, J: both sides of a film, one where a region beyond has the other.

    Args:
        area: [n_e] m^2.
        gamma: [n_e] relative surfactant concentration.
        region: [n] region of each E.
        tension: [regions] sigma_0, N/m.
        slope: R T Gamma_0, N/m.
        cover: [n_e] c; null for a film without regions beyond it, c = 0.
        n: number of E.
        part: parts.
    """
    c = wp.tid()
    size = (n + part.shape[0] - 1) // part.shape[0]
    total = wp.float64(0.0)
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        sides = float(2.0)
        if cover:
            sides = 2.0 - cover[i]
        total += wp.float64(sides * (tension[region[i]] - slope * gamma[i]) * area[i])
    part[c] = total


@wp.kernel
def look_chunks(
    x: wp.array(dtype=wp.vec3),
    mass: wp.array(dtype=float),
    eta: wp.array(dtype=float),
    behind: wp.array(dtype=wp.int32),
    gas: wp.array2d(dtype=wp.float64),
    first: wp.array(dtype=wp.int32),
    # outputs
    part: wp.array(dtype=vec6d),
):
    """Parts of what must be known of a film at the end of a frame.

    Slots: 0-2 place of the first E, 3 least eta and 4 the E that has it, 5 mean area of an E of the region.

    Args:
        x: [n] m.
        mass: [n_e] kg; E without are not there.
        eta: [n] m.
        behind: [n_e] 1 for E that a free rim has passed; null for a film without holes.
        gas: [regions, 6] see `gas`.
        first: [regions + 1] first E of each region.
        part: parts, region by region.
    """
    c = wp.tid()
    region = part_region(c, first, part.shape[0])
    start, stop = part_range(c, first, part.shape[0])
    seen = vec6d()
    for k in range(3):
        seen[k] = wp.float64(x[0][k])
    seen[3] = wp.float64(1.0e30)
    for i in range(start, stop):
        there = mass[i] > 0.0
        if behind:
            there = there and behind[i] == 0
        if there and wp.float64(eta[i]) < seen[3]:
            seen[3] = wp.float64(eta[i])
            seen[4] = wp.float64(i)
    seen[5] = gas[region, AREA] / wp.float64(wp.max(first[region + 1] - first[region], 1))
    part[c] = seen


@wp.kernel
def find_broken(
    x: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    stage: int,
    # outputs
    broken: wp.array(dtype=wp.int32),
):
    """Record the first stage and the lowest particle whose position or velocity is not finite.

    broken = [stage or 0, particle]; a stage recorded before stays.
    """
    i = wp.tid()
    p = x[i]
    v = u[i]
    s = p[0] + p[1] + p[2] + v[0] + v[1] + v[2]
    if not wp.isfinite(s):
        if broken[0] == 0 or broken[0] == stage:
            wp.atomic_min(broken, 1, i)
            broken[0] = stage


@wp.kernel
def travel_chunks(
    v: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    frame: wp.array(dtype=wp.vec3),
    dt: wp.array(dtype=float),
    n: int,
    # outputs
    part: wp.array(dtype=float),
):
    """Parts of the largest distance moved in a step relative to the region as a whole, m."""
    c = wp.tid()
    size = (n + part.shape[0] - 1) // part.shape[0]
    far = float(0.0)
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        far = wp.max(far, wp.length_sq(v[i] - frame[region[i]]))
    part[c] = dt[0] * wp.sqrt(far)


@wp.kernel
def steepest_chunks(
    affine: wp.array(dtype=wp.mat33),
    mass: wp.array(dtype=float),
    # outputs
    part: wp.array(dtype=float),
):
    """Parts of the largest velocity gradient B D^-1 of L (Frobenius), 1/s, but for those without liquid."""
    c = wp.tid()
    n = mass.shape[0]
    size = (n + part.shape[0] - 1) // part.shape[0]
    most = float(0.0)
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        if mass[i] > 0.0:
            most = wp.max(most, wp.ddot(affine[i], affine[i]))
    part[c] = wp.sqrt(most)


@wp.kernel
def moved_chunks(
    x: wp.array(dtype=wp.vec3),
    x_old: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    frame: wp.array(dtype=wp.vec3),
    dt: wp.array(dtype=float),
    n: int,
    # outputs
    part: wp.array(dtype=float),
):
    """As `travel_chunks`, from positions before and after the step."""
    c = wp.tid()
    size = (n + part.shape[0] - 1) // part.shape[0]
    far = float(0.0)
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        far = wp.max(far, wp.length_sq(x[i] - x_old[i] - dt[0] * frame[region[i]]))
    part[c] = wp.sqrt(far)
