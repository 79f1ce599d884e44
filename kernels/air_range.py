"""Where the linear theory of the air ends: the slope of a film, and kinetic energy kept from growing by its motion."""

import warp as wp

wp.set_module_options({"enable_backward": False})

vec4d = wp.types.vector(length=4, dtype=wp.float64)

# Slots of the array that the parts' totals go to.
SLOPE = wp.constant(0)
BEFORE = wp.constant(1)
AFTER = wp.constant(2)
WORST = wp.constant(3)
TAKEN = wp.constant(4)


@wp.kernel
def centre_chunks(
    x: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    n: int,
    # outputs
    part: wp.array(dtype=vec4d),
):
    """Parts of (sum a x, sum a)."""
    c = wp.tid()
    size = (n + part.shape[0] - 1) // part.shape[0]
    total = vec4d()
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        p = area[i] * x[i]
        total += vec4d(wp.float64(p[0]), wp.float64(p[1]), wp.float64(p[2]), wp.float64(area[i]))
    part[c] = total


@wp.kernel
def find_centre(part: wp.array(dtype=vec4d), centre: wp.array(dtype=wp.vec3)):
    """Middle of the film, centre[0], m."""
    total = vec4d()
    for c in range(part.shape[0]):
        total += part[c]
    centre[0] = wp.vec3(float(total[0] / total[3]), float(total[1] / total[3]), float(total[2] / total[3]))


@wp.kernel
def slope_chunks(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    area: wp.array(dtype=float),
    centre: wp.array(dtype=wp.vec3),
    n: int,
    # outputs
    part: wp.array(dtype=wp.vec2d),
):
    """Parts of (sum a sin^2, sum a), the angle that between the normal and the ray from the middle of the film."""
    c = wp.tid()
    size = (n + part.shape[0] - 1) // part.shape[0]
    total = wp.vec2d()
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        along = wp.dot(wp.normalize(x[i] - centre[0]), normal[i])
        total += wp.vec2d(wp.float64(area[i] * wp.max(1.0 - along * along, 0.0)), wp.float64(area[i]))
    part[c] = total


@wp.kernel
def find_slope(part: wp.array(dtype=wp.vec2d), found: wp.array(dtype=wp.float64)):
    """Root mean square of the sine, found[SLOPE], and the worst yet."""
    total = wp.vec2d()
    for c in range(part.shape[0]):
        total += part[c]
    found[SLOPE] = wp.sqrt(total[0] / total[1])
    found[WORST] = wp.max(found[WORST], found[SLOPE])


@wp.kernel
def load_speed_e(
    u: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    motion: wp.array(dtype=wp.vec3),
    found: wp.array(dtype=wp.float64),
    limit: wp.float64,
    # outputs
    speed: wp.array(dtype=float),
):
    """Normal speed relative to the film as a whole where the slope is above `limit`, 0 everywhere else. [n_e], m/s."""
    i = wp.tid()
    speed[i] = wp.where(found[SLOPE] > limit, wp.dot(u[i] - motion[0], normal[i]), float(0.0))


@wp.kernel
def air_energy_chunks(
    speed: wp.array(dtype=float),
    moved: wp.array(dtype=float),
    mass: wp.array(dtype=float),
    area: wp.array(dtype=float),
    n: int,
    # outputs
    part: wp.array(dtype=wp.float64),
):
    """Parts of the kinetic energy of the normal motion, film and air, sum (m v + a A v) v/2, J.

    Args:
        speed: [n_e] v, m/s.
        moved: [n_e] A v, kg/(m s).
        mass: [n_e] kg.
        area: [n_e] m^2.
        n: number of E.
        part: parts.
    """
    c = wp.tid()
    size = (n + part.shape[0] - 1) // part.shape[0]
    total = wp.float64(0.0)
    for i in range(c * size, wp.min(n, (c + 1) * size)):
        total += wp.float64(0.5 * (mass[i] * speed[i] + area[i] * moved[i])) * wp.float64(speed[i])
    part[c] = total


@wp.kernel
def sum_energy(part: wp.array(dtype=wp.float64), slot: int, found: wp.array(dtype=wp.float64)):
    """Put the total into found[slot]."""
    total = wp.float64(0.0)
    for c in range(part.shape[0]):
        total += part[c]
    found[slot] = total


@wp.kernel
def book_taken(found: wp.array(dtype=wp.float64)):
    """Add up what `slow_air_e` takes, found[TAKEN], J."""
    found[TAKEN] = found[TAKEN] + wp.max(found[AFTER] - found[BEFORE], wp.float64(0.0))


@wp.kernel
def slow_air_e(
    speed: wp.array(dtype=float),
    normal: wp.array(dtype=wp.vec3),
    found: wp.array(dtype=wp.float64),
    # outputs
    u: wp.array(dtype=wp.vec3),
):
    """Slow the normal motion so that its energy is no more than before E moved. [n_e], m/s."""
    i = wp.tid()
    if found[AFTER] > found[BEFORE]:
        share = float(wp.sqrt(found[BEFORE] / found[AFTER]))
        u[i] = u[i] - (1.0 - share) * speed[i] * normal[i]
