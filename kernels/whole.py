"""One mesh of a whole foam: which region holds a point of space, and where the sheets of two regions are one film.

Sheets of two regions cling together and round the corner in which they part. They part where their outward normals,
added up, are longer than 1: on a Plateau border of 120 degrees those of two sheets open by 60 degrees, however far from
the border rounding starts; within a foam, where the sheets of three or four regions meet, they cancel.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

OUT = wp.constant(-1)
"""Label of what no region holds."""

CLING = wp.constant(0.25)
"""Two sheets back to back are one film up to this distance, spacings."""

OPEN = wp.constant(0.9)
"""They are up to this distance where they have opened by 60 degrees."""

OPENED = wp.constant(1.0471976)
"""60 degrees, rad."""

SHARP = wp.constant(0.7)
BLUNT = wp.constant(1.3)
"""A free film follows its own sheet where that of another region is farther than `BLUNT` spacings, and runs straight
into the border where it is nearer than `SHARP`, as its sheet turns into the partition there."""

EVERYWHERE = wp.constant(1.0e6)
"""Farther than any surface, m."""

four_regions = wp.types.vector(length=4, dtype=wp.int32)
four_numbers = wp.types.vector(length=4, dtype=wp.float32)
four_vectors = wp.types.matrix(shape=(4, 3), dtype=wp.float32)


@wp.struct
class Skins:
    """The closed meshes of all regions.

    Attributes:
        mesh: [regions] ids of their `wp.Mesh`.
        begin: [regions] place of its first vertex in the arrays that follow.
        normal: [n] outward unit normals.
        thickness: [n] nm.
        velocity: [n] m/s.
        low: [regions] corner of a box that holds it, m.
        high: [regions] the opposite corner.
        spacing: [regions] distance between E, m.
    """

    mesh: wp.array(dtype=wp.uint64)
    begin: wp.array(dtype=wp.int32)
    normal: wp.array(dtype=wp.vec3)
    thickness: wp.array(dtype=wp.float32)
    velocity: wp.array(dtype=wp.vec3)
    low: wp.array(dtype=wp.vec3)
    high: wp.array(dtype=wp.vec3)
    spacing: wp.array(dtype=wp.float32)


@wp.struct
class Foot:
    """The point of a region's mesh next to a place: corners, their weights, the normal, signed distance (m)."""

    corner: wp.vec3i
    weight: wp.vec3
    normal: wp.vec3
    distance: wp.float32


@wp.func
def foot_of(skins: Skins, r: int, p: wp.vec3) -> Foot:
    """Foot of p on region r; the distance is below 0 inside."""
    id = skins.mesh[r]
    query = wp.mesh_query_point_no_sign(id, p, EVERYWHERE)
    foot = Foot()
    at = skins.begin[r]
    a = at + wp.mesh_get_index(id, 3 * query.face)
    b = at + wp.mesh_get_index(id, 3 * query.face + 1)
    c = at + wp.mesh_get_index(id, 3 * query.face + 2)
    w = 1.0 - query.u - query.v
    foot.corner = wp.vec3i(a, b, c)
    foot.weight = wp.vec3(query.u, query.v, w)
    foot.normal = wp.normalize(query.u * skins.normal[a] + query.v * skins.normal[b] + w * skins.normal[c])
    away = p - wp.mesh_eval_position(id, query.face, query.u, query.v)
    foot.distance = wp.where(wp.dot(away, foot.normal) < 0.0, -wp.length(away), wp.length(away))
    return foot


@wp.func
def may_reach(skins: Skins, r: int, p: wp.vec3, margin: float) -> bool:
    """Whether p is in the box of a region, `margin` spacings wider."""
    m = margin * skins.spacing[r]
    low = skins.low[r]
    high = skins.high[r]
    for k in range(3):
        if p[k] < low[k] - m or p[k] > high[k] + m:
            return False
    return True


@wp.func
def region_at(skins: Skins, p: wp.vec3) -> int:
    """The region that holds p, the nearest of those whose sheets are one film there, or `OUT`."""
    region = four_regions(-1, -1, -1, -1)
    distance = four_numbers()
    normal = four_vectors()
    found = int(0)
    for r in range(skins.mesh.shape[0]):
        if may_reach(skins, r, p, OPEN):
            foot = foot_of(skins, r, p)
            at = wp.min(found, 3)
            if found < 4 or foot.distance < distance[3]:
                while at > 0 and distance[wp.max(at - 1, 0)] > foot.distance:
                    region[at] = region[at - 1]
                    distance[at] = distance[at - 1]
                    normal[at] = normal[at - 1]
                    at -= 1
                region[at] = r
                distance[at] = foot.distance
                normal[at] = foot.normal
                found = wp.min(found + 1, 4)
    if found == 0:
        return OUT
    if distance[0] <= 0.0:
        return region[0]
    near = int(0)
    together = normal[0]
    for k in range(1, found):
        h = 0.5 * (skins.spacing[region[0]] + skins.spacing[region[k]])
        opened = wp.acos(wp.clamp(-wp.dot(normal[0], normal[k]), -1.0, 1.0)) / OPENED
        if distance[0] + distance[k] < h * (CLING + (OPEN - CLING) * wp.min(opened, 1.0)):
            together += normal[k]
            near += 1
    if near == 0 or wp.length_sq(together) > 1.0:
        return OUT
    return region[0]


@wp.kernel
def find_labels_n(
    skins: Skins,
    point: wp.array(dtype=wp.vec3),
    # outputs
    label: wp.array(dtype=wp.int32),
):
    """The region of each node, [n] m, or `OUT`."""
    i = wp.tid()
    label[i] = region_at(skins, point[i])


@wp.kernel
def place_v(
    skins: Skins,
    labels: wp.array(dtype=wp.vec4i),
    outside: wp.array(dtype=wp.int32),
    step: float,
    rounds: int,
    # outputs
    place: wp.array(dtype=wp.vec3),
):
    """Move vertices to where the regions around them meet.

    A free film lies on the sheet of its region, a partition half way between two sheets, a border within the foam where
    three are equally far. A border on the outside of a foam lies where the sheets part besides: halved steps.

    Args:
        skins: the regions.
        labels: [n] regions around each vertex, -1 after the last.
        outside: [n] whether the outside is one of them.
        step: the first step towards where sheets part, m; the vertex stays within three of where it was.
        rounds: how many of these steps.
        place: [n] m, in and out.
    """
    i = wp.tid()
    own = labels[i]
    count = int(0)
    for k in range(4):
        if own[k] >= 0:
            count += 1
    start = place[i]
    p = start
    ahead = float(step)
    # distances are all but linear: films are there at once
    for _ in range(wp.where(outside[i] == 1 and count > 1, rounds, 3)):
        mean = float(0.0)
        pull = wp.vec3(0.0, 0.0, 0.0)
        opens = wp.vec3(0.0, 0.0, 0.0)
        for k in range(count):
            foot = foot_of(skins, own[k], p)
            mean += foot.distance / float(count)
            pull += foot.distance * foot.normal
            opens += foot.normal
        if count == 1:
            p -= pull
        else:
            # exact for sheets back to back, at 120 degrees and at those of a tetrahedron
            rate = wp.where(count == 2, 0.5, wp.where(count == 3, 0.667, 0.75))
            p -= rate * (pull - mean * opens)
            if outside[i] == 1:
                side = wp.where(region_at(skins, p) == OUT, -1.0, 1.0)
                p += side * ahead * wp.normalize(opens)
                ahead *= 0.6
        away = p - start
        if wp.length(away) > 3.0 * step:
            p = start + 3.0 * step * wp.normalize(away)
    place[i] = p


@wp.kernel
def draw_back_v(
    skins: Skins,
    labels: wp.array(dtype=wp.vec4i),
    outside: wp.array(dtype=wp.int32),
    # outputs
    place: wp.array(dtype=wp.vec3),
):
    """Move vertices of films back onto them; a free film runs straight next to its borders. As for `place_v`."""
    i = wp.tid()
    own = labels[i]
    p = place[i]
    if own[1] < 0:
        foot = foot_of(skins, own[0], p)
        near = float(BLUNT)
        for r in range(skins.mesh.shape[0]):
            if r != own[0] and may_reach(skins, r, p, BLUNT):
                other = foot_of(skins, r, p)
                near = wp.min(near, wp.abs(other.distance) / skins.spacing[r])
        place[i] = p - wp.smoothstep(SHARP, BLUNT, near) * foot.distance * foot.normal
    elif own[2] < 0 and outside[i] == 0:
        one = foot_of(skins, own[0], p)
        two = foot_of(skins, own[1], p)
        place[i] = p - 0.25 * (one.distance - two.distance) * (one.normal - two.normal)


@wp.kernel
def read_skins_v(
    skins: Skins,
    labels: wp.array(dtype=wp.vec4i),
    place: wp.array(dtype=wp.vec3),
    # outputs
    normal: wp.array2d(dtype=wp.vec3),
    thickness: wp.array2d(dtype=wp.float32),
    velocity: wp.array(dtype=wp.vec3),
):
    """What the sheets around each vertex are like there.

    Args:
        skins: the regions.
        labels: [n] regions around each vertex, -1 after the last.
        place: [n] m.
        normal: [n, 4] outward unit normal of each sheet.
        thickness: [n, 4] nm.
        velocity: [n] mean of the sheets, m/s.
    """
    i = wp.tid()
    own = labels[i]
    count = float(0.0)
    u = wp.vec3(0.0, 0.0, 0.0)
    for k in range(4):
        if own[k] >= 0:
            foot = foot_of(skins, own[k], place[i])
            c = foot.corner
            w = foot.weight
            normal[i, k] = foot.normal
            thickness[i, k] = w[0] * skins.thickness[c[0]] + w[1] * skins.thickness[c[1]] + w[2] * skins.thickness[c[2]]
            u += w[0] * skins.velocity[c[0]] + w[1] * skins.velocity[c[1]] + w[2] * skins.velocity[c[2]]
            count += 1.0
    velocity[i] = u / count


@wp.kernel
def find_away_n(
    skins: Skins,
    point: wp.array(dtype=wp.vec3),
    # outputs
    away: wp.array(dtype=wp.float32),
):
    """Distance of each point [n] (m) from the nearest region, spacings."""
    i = wp.tid()
    least = float(1.0e6)
    for r in range(skins.mesh.shape[0]):
        if may_reach(skins, r, point[i], 1.0):
            least = wp.min(least, wp.abs(foot_of(skins, r, point[i]).distance) / skins.spacing[r])
    away[i] = least
