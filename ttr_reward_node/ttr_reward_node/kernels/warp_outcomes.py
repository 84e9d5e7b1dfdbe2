"""Outcomes of the steps near target and obstacles with NVIDIA Warp, on a GPU or the CPU.

The rules are those of `kernels.boundary_conditions`, with one thread per node and pair.
"""

# No `from __future__ import annotations`: Warp needs annotations as objects. In Warp, `int(0)` declares a variable, `0`
# a constant.
# ruff: noqa: UP018
import warp as wp

from ttr_reward_node.kernels import boundary_conditions as conditions

_BLOCKED, _PASSES_TARGET = wp.constant(conditions.BLOCKED), wp.constant(conditions.PASSES_TARGET)
_INTERPOLATE = wp.constant(conditions.INTERPOLATE)
_MARGIN, _MARGIN_OF_LONG = (
    wp.constant(wp.float64(conditions.MARGIN)),
    wp.constant(wp.float64(conditions.MARGIN_OF_LONG)),
)
_SLACK = wp.constant(wp.float64(1e-6))
_MISSED, _HIT_OBSTACLE = wp.constant(wp.float64(2.0)), wp.constant(wp.float64(-1.0))
_ZERO, _ONE, _HALF, _QUARTER = (wp.constant(wp.float64(number)) for number in (0.0, 1.0, 0.5, 0.25))


@wp.struct
class Boundary:
    """Target and obstacles (see `boundary_conditions.BoundaryConditions`), axes of the grid, rate of the transform."""

    box: wp.array2d[wp.float64]
    disc: wp.array[wp.float64]
    disc_axes: wp.array[int]
    clearance: wp.array2d[float]
    clearance_axes: wp.array[int]
    cell: wp.float64
    counts: wp.array[int]
    strides: wp.array[int]
    periodic: wp.array[int]
    rate: wp.float64


@wp.struct
class Path:
    """Straight segments of one step, and its start.

    Attributes:
        moves: Displacements after each segment, for all slabs and pairs (k, pairs, parts, n) [cells].
        before: Displacements of the preceding step, used only if `goes_on` is 1.
        slab, pair: Indices of the step.
        node: Start node of the step, or of the preceding step.
        goes_on: 1 if this step starts at the end of the preceding one, else 0.
    """

    moves: wp.array4d[float]
    before: wp.array4d[float]
    slab: int
    pair: int
    node: int
    goes_on: int


@wp.func
def _start(path: Path, k: int, boundary: Boundary) -> wp.float64:
    """Return the start of a path along axis k [cells]."""
    at = wp.float64(path.node // boundary.strides[k] % boundary.counts[k])
    if path.goes_on == 1:
        at += wp.float64(path.before[path.slab, path.pair, path.before.shape[2] - 1, k])
    return at


@wp.func
def _move(path: Path, part: int, k: int) -> wp.float64:
    """Return the displacement after segment `part` of the path along axis k [cells]; 0 before the first."""
    if part < 0:
        return _ZERO
    return wp.float64(path.moves[path.slab, path.pair, part, k])


@wp.func
def _nearest(at: wp.float64, k: int, boundary: Boundary) -> wp.float64:
    """Shift a position by whole periods to its image nearest to the target's centre."""
    if boundary.periodic[k] == 0:
        return at
    count = wp.float64(boundary.counts[k])
    middle = _HALF * (boundary.box[k, 0] + boundary.box[k, 1])
    return at - wp.rint((at - middle) / count) * count


@wp.func
def _is_free(k: int, boundary: Boundary) -> bool:
    return wp.isinf(boundary.box[k, 0]) or wp.isinf(boundary.box[k, 1])


@wp.func
def _clearance_at(clearance: wp.array2d[float], first: wp.float64, second: wp.float64) -> wp.float64:
    a = wp.clamp(first, _ZERO, wp.float64(clearance.shape[0] - 1))
    b = wp.clamp(second, _ZERO, wp.float64(clearance.shape[1] - 1))
    i = int(a)
    j = int(b)
    i1 = wp.min(i + 1, clearance.shape[0] - 1)
    j1 = wp.min(j + 1, clearance.shape[1] - 1)
    a -= wp.float64(i)
    b -= wp.float64(j)
    lower = wp.float64(clearance[i, j]) * (_ONE - b) + wp.float64(clearance[i, j1]) * b
    upper = wp.float64(clearance[i1, j]) * (_ONE - b) + wp.float64(clearance[i1, j1]) * b
    return lower * (_ONE - a) + upper * a


@wp.func
def _may_hit(path: Path, boundary: Boundary) -> bool:
    """Whether the bounding box of a path meets the target's intervals."""
    parts = path.moves.shape[2]
    hits = bool(True)
    for k in range(boundary.box.shape[0]):
        if hits and not _is_free(k, boundary):
            low = wp.float64(0.0)
            high = wp.float64(0.0)
            for part in range(parts):
                low = wp.min(low, _move(path, part, k))
                high = wp.max(high, _move(path, part, k))
            at = _nearest(_start(path, k, boundary), k, boundary)
            wide = boundary.periodic[k] == 1 and high - low > _QUARTER * wp.float64(boundary.counts[k])
            outside = at + high < boundary.box[k, 0] - _SLACK or at + low > boundary.box[k, 1] + _SLACK
            hits = wide or not outside
    return hits


@wp.func
def _obstacle_ahead(path: Path, part: int, end: wp.float64, margin: wp.float64, boundary: Boundary) -> bool:
    """Whether an obstacle blocks straight segment `part` of the step before its fraction `end`."""
    i = boundary.clearance_axes[0]
    j = boundary.clearance_axes[1]
    if i < 0:
        return False
    from_i = _start(path, i, boundary) + _move(path, part - 1, i)
    from_j = _start(path, j, boundary) + _move(path, part - 1, j)
    by_i = _move(path, part, i) - _move(path, part - 1, i)
    by_j = _move(path, part, j) - _move(path, part - 1, j)
    far = wp.float64(2.0) * end * wp.max(wp.abs(by_i), wp.abs(by_j)) - wp.float64(1e-3)
    count = wp.max(1, int(wp.ceil(far)))
    blocked = bool(False)
    for turn in range(count):
        way = end * wp.float64(turn + 1) / wp.float64(count)
        second = wp.where(i == j, _ZERO, from_j + way * by_j)
        blocked = blocked or _clearance_at(boundary.clearance, from_i + way * by_i, second) <= margin
    return blocked


@wp.func
def _target_entry(path: Path, part: int, boundary: Boundary) -> wp.float64:
    """Return the fraction of straight segment `part` of the step at which it enters the target; 2 if it does not."""
    enter = wp.float64(0.0)
    leave = wp.float64(1.0)
    for k in range(boundary.box.shape[0]):
        if not _is_free(k, boundary):
            low = boundary.box[k, 0]
            high = boundary.box[k, 1]
            before = _move(path, part - 1, k)
            a = _nearest(_start(path, k, boundary) + before, k, boundary)
            b = _move(path, part, k) - before
            if b == _ZERO:
                if a < low - _SLACK or a > high + _SLACK:
                    leave = _HIT_OBSTACLE  # below `enter`, so the target is missed
            else:
                enter = wp.max(enter, wp.min((low - a) / b, (high - a) / b))
                leave = wp.min(leave, wp.max((low - a) / b, (high - a) / b))
    i = boundary.disc_axes[0]
    j = boundary.disc_axes[1]
    if i >= 0:
        dx = boundary.disc[3]
        dy = boundary.disc[4]
        ax = (_start(path, i, boundary) + _move(path, part - 1, i)) * dx - boundary.disc[0]
        ay = (_start(path, j, boundary) + _move(path, part - 1, j)) * dy - boundary.disc[1]
        bx = (_move(path, part, i) - _move(path, part - 1, i)) * dx
        by = (_move(path, part, j) - _move(path, part - 1, j)) * dy
        aa = ax * ax + ay * ay - boundary.disc[2] * boundary.disc[2]
        ab = ax * bx + ay * by
        bb = bx * bx + by * by
        square = ab * ab - aa * bb
        if square < _ZERO or (bb == _ZERO and aa > _ZERO):
            return _MISSED
        if bb > _ZERO:
            root = wp.sqrt(square)
            enter = wp.max(enter, (-ab - root) / bb)
            leave = wp.min(leave, (-ab + root) / bb)
    return wp.where(enter <= leave, enter, _MISSED)


@wp.func
def _classify(path: Path, obstacles: bool, margin: wp.float64, boundary: Boundary) -> wp.float64:
    """Return the fraction of the step at which it hits the target; 2 for a miss, -1 if an obstacle blocks it."""
    aims = _may_hit(path, boundary)
    if not (aims or obstacles):
        return _MISSED
    parts = path.moves.shape[2]
    found = wp.float64(2.0)
    for part in range(parts):
        if found == _MISSED:
            t = wp.float64(2.0)
            if aims:
                t = _target_entry(path, part, boundary)
            if obstacles and _obstacle_ahead(path, part, wp.min(t, _ONE), margin, boundary):
                found = _HIT_OBSTACLE
            elif t <= _ONE:
                found = (wp.float64(part) + t) / wp.float64(parts)
    return found


@wp.func
def _within_cell_of_target(path: Path, boundary: Boundary) -> bool:
    """Whether the start of a path is less than a cell away from the target along every axis."""
    within = bool(True)
    for k in range(boundary.box.shape[0]):
        if not _is_free(k, boundary):
            at = _nearest(_start(path, k, boundary), k, boundary)
            within = within and at > boundary.box[k, 0] - _ONE and at < boundary.box[k, 1] + _ONE
    i = boundary.disc_axes[0]
    j = boundary.disc_axes[1]
    if i >= 0:
        dx = boundary.disc[3]
        dy = boundary.disc[4]
        x = _start(path, i, boundary) * dx - boundary.disc[0]
        y = _start(path, j, boundary) * dy - boundary.disc[1]
        within = within and wp.sqrt(x * x + y * y) < boundary.disc[2] + wp.sqrt(dx * dx + dy * dy)
    return within


@wp.kernel(enable_backward=False, module="unique")
def find_outcomes(
    nodes: wp.array[int],
    slabs: wp.array[int],
    durations: wp.array2d[wp.float64],
    moves: wp.array4d[float],
    ahead: wp.array4d[float],
    more: wp.array2d[wp.float64],
    reach: wp.array2d[wp.float64],
    is_long: wp.array[wp.uint8],
    boundary: Boundary,
    outcomes: wp.array2d[float],
):
    """Fill in the outcome of each pair's step from each node, as `boundary_conditions.find_outcomes` does."""
    i, p = wp.tid()
    slab = slabs[i]
    duration = durations[slab, p]
    outcomes[i, p] = _INTERPOLATE
    if duration == _ZERO:
        return
    path = Path(moves, moves, slab, p, nodes[i], 0)
    margin = wp.where(is_long[p] == wp.uint8(1), _MARGIN_OF_LONG, _MARGIN) * boundary.cell
    obstacles = bool(False)
    first = boundary.clearance_axes[0]
    if first >= 0:
        second = wp.where(
            first == boundary.clearance_axes[1], _ZERO, _start(path, boundary.clearance_axes[1], boundary)
        )
        free = _clearance_at(boundary.clearance, _start(path, first, boundary), second)
        obstacles = free <= reach[slab, p] + margin
    t = _classify(path, obstacles, margin, boundary)
    if t < _ZERO:
        outcomes[i, p] = _BLOCKED
    elif t <= _ONE:
        outcomes[i, p] = float(wp.exp(-boundary.rate * t * duration))
    else:
        rest = Path(ahead, moves, slab, p, nodes[i], 1)
        if _within_cell_of_target(rest, boundary):
            further = more[slab, p]
            t = wp.float64(2.0)
            if further > _ZERO:
                t = _classify(rest, True, _ZERO, boundary)
            outcomes[i, p] = _PASSES_TARGET
            if t >= _ZERO and t <= _ONE:
                outcomes[i, p] = float(wp.exp(-boundary.rate * (duration + t * further)))
