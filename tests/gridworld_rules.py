"""The rules of the gridworld in plain Python, written from the paper and the release: an oracle."""

from zipf.envs.gridworld import looks
from zipf.envs.gridworld.maps import MOVES
from zipf.envs.gridworld.single import GridworldEnv


class ByHand(GridworldEnv):
    """One gridworld whose moves are not those of the compiled function."""

    def _move(self, action: int) -> tuple[bool, bool]:
        map, target, row, column = self._world[0].tolist()
        board = self.level.maps.boards[map].tolist()
        down, right = MOVES[action]
        cut_off = (
            down != 0
            and right != 0
            and board[row + down][column] == board[row][column + right] == looks.WALL
        )
        if board[row + down][column + right] != looks.WALL and not cut_off:
            row, column = row + down, column + right
            self._world[0, 2:] = row, column
        goal = self.level.maps.cells[map, target].tolist()
        return [row, column] == goal, board[row][column] >= looks.FIRST_LOOK
