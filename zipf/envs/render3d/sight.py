"""Which faces of solid cells are visible from a point in a grid."""

from zipf.compiled import compiled
from zipf.envs.render3d.rounding import floor
from zipf.envs.render3d.spans import narrow


@compiled(references=False, error_model="numpy")
def look_around(solid, x, y, left_x, left_y, right_x, right_y, seen, spans):
    """Marks the faces of solid cells that are visible from a point, between two directions.

    For each of the four axis directions, cells are visited in columns of growing distance. The rays
    that have not been blocked are kept as spans of slopes. In every column a span is split where
    its rays enter different cells, and the parts that meet no solid cell are kept.
    Returns False, with nothing marked, if the point is in a solid cell or outside the grid.

    Args:
        solid: bool [rows, columns].
        x, y: the point, in cells.
        left_x, left_y, right_x, right_y: the directions, less than half a turn apart.
        seen: bool [rows * columns * 4], written; see `Scenes.wall_face`.
        spans: float64 [4, .], overwritten.
    """
    rows, columns = solid.shape
    own_row, own_column = floor(y), floor(x)
    if not (0 <= own_row < rows and 0 <= own_column < columns) or solid[own_row, own_column]:
        return False
    seen[:] = False
    for ahead in range(4):
        px, py = (1, 0, -1, 0)[ahead], (0, 1, 0, -1)[ahead]
        sx, sy = -py, px  # to the left, the direction in which slopes grow
        past = x - own_column if px > 0 else own_column + 1 - x
        aside = y - own_row if px > 0 else own_row + 1 - y
        if px == 0:
            past = y - own_row if py > 0 else own_row + 1 - y
            aside = own_column + 1 - x if py > 0 else x - own_column
        low, high = narrow(-1.0, 1.0, right_x * py - right_y * px, right_x * sy - right_y * sx)
        low, high = narrow(low, high, px * left_y - py * left_x, sx * left_y - sy * left_x)
        count = 0
        if low < high:
            spans[0, 0], spans[1, 0] = low, high
            count = 1
        step = 0
        now = 0
        while count:
            near, far = max(step - past, 0.0), step + 1 - past
            column, row = own_column + step * px, own_row + step * py
            after = 2 - now
            open_count = 0
            for k in range(count):
                slope, end = spans[now, k], spans[now + 1, k]
                enters = floor(aside + slope * near)
                leaves = floor(aside + slope * far)
                while slope < end:
                    next_enters = (enters + 1 - aside) / near if near > 0.0 else 2.0
                    next_leaves = (leaves + 1 - aside) / far
                    until = min(next_enters, next_leaves, end)
                    if until > slope:
                        r, c = row + enters * sy, column + enters * sx
                        side = (ahead + 2) & 3
                        inside = 0 <= r < rows and 0 <= c < columns
                        stopped = not inside or solid[r, c]
                        if not stopped and leaves != enters:
                            r, c = row + leaves * sy, column + leaves * sx
                            side = (ahead + 3) & 3 if leaves > enters else (ahead + 1) & 3
                            inside = 0 <= r < rows and 0 <= c < columns
                            stopped = not inside or solid[r, c]
                        if stopped:
                            if inside:
                                seen[(r * columns + c) * 4 + side] = True
                        elif open_count and spans[after + 1, open_count - 1] == slope:
                            spans[after + 1, open_count - 1] = until
                        else:
                            spans[after, open_count], spans[after + 1, open_count] = slope, until
                            open_count += 1
                        slope = until
                    if next_enters <= until:
                        enters += 1
                    if next_leaves <= until:
                        leaves += 1
            now, count = after, open_count
            step += 1
    return True
