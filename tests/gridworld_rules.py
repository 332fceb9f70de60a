"""The rules of the gridworld in plain Python, written from the paper and the release: an oracle."""

from zipf.envs.gridworld import sprites
from zipf.envs.gridworld.gridworld_env import GridworldEnv
from zipf.envs.gridworld.maps import MOVES


class ByHand(GridworldEnv):
    """One gridworld whose moves are not those of the compiled function."""

    def _move(self, action: int) -> tuple[bool, bool]:
        map, target, row, column = self._env[0].tolist()
        board = self.level.maps.boards[map].tolist()
        down, right = MOVES[action]
        cut_off = (
            down != 0
            and right != 0
            and board[row + down][column] == board[row][column + right] == sprites.WALL
        )
        if board[row + down][column + right] != sprites.WALL and not cut_off:
            row, column = row + down, column + right
            self._env[0, 2:] = row, column
        goal = self.level.maps.cells[map, target].tolist()
        return [row, column] == goal, board[row][column] >= sprites.FIRST_LOOK
