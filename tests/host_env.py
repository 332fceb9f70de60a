"""A tensor environment that steps a NumPy batch: the slow oracle of what collects from tensors."""

import numpy as np
import torch

from zipf.envs.tensor import Stepped, TensorEnv


class Host(TensorEnv):
    """Plays `env`, a `ZipfVectorEnv`; its codes are the observations themselves."""

    def __init__(self, env, goal=None, symmetries=None, max_steps=100):
        super().__init__(
            env.num_envs,
            single_observation_space=env.single_observation_space,
            single_action_space=env.single_action_space,
            situation=env.situation,
            max_steps=max_steps,
            device="cpu",
        )
        self.env, self.goal, self.symmetries = env, goal, symmetries
        self.achieves, self.reports_success = env.achieves, env.reports_success
        self.reset(0)

    def tensors(self):
        return {}

    def begin(self, mask, forced=None):
        raise AssertionError("the batch begins episodes by itself")

    def reset(self, seed):
        self.generator.manual_seed(seed)
        self.shown, _ = self.env.reset(seed=seed)

    def report_achieved(self):
        super().report_achieved()
        self.env.report_achieved()

    def observe(self):
        return {name: torch.from_numpy(part.copy()) for name, part in self.shown.items()}

    def step(self, action):
        self.shown, reward, terminated, truncated, info = self.env.step(action.numpy())
        ended = terminated | truncated
        final, outcome = self.observe(), {}
        if ended.any():
            for name, part in final.items():
                part[ended] = torch.from_numpy(info["final_obs"][name][ended])
            outcome = info["final_info"]
        names = [*self.situation, "return", "length", *["success"] * self.reports_success]
        if self._reports_achieved:
            names += ["achieved", "has_achieved"]
        zeros = dict.fromkeys(names, np.zeros(self.num_envs, np.int64))
        zeros["has_achieved"] = np.zeros(self.num_envs, np.bool_)
        if self.goal is not None:
            asked = self.goal.read({name: part.numpy() for name, part in self.observe().items()})
            zeros["achieved"] = np.zeros_like(asked)
        found = {name: torch.from_numpy(np.array(outcome.get(name, zeros[name]))) for name in names}
        return Stepped(
            torch.from_numpy(reward).float(),
            torch.from_numpy(terminated.copy()),
            torch.from_numpy(truncated.copy()),
            final,
            found,
        )

    def decode(self, codes, symmetry=None):
        shown = {name: part.clone() for name, part in codes.items()}
        if symmetry is not None:
            flat = {
                name: part.flatten(0, symmetry.ndim - 1).numpy() for name, part in shown.items()
            }
            which = symmetry.flatten().numpy()
            self.symmetries(flat, which, np.ones(len(which), np.bool_))
        return shown

    def read_goal(self, codes):
        name = next(iter(codes))
        batch = codes[name].shape[: codes[name].ndim - len(self.shapes[name])]
        flat = {k: v.reshape(-1, *self.shapes[k]).numpy() for k, v in codes.items()}
        return torch.from_numpy(self.goal.read(flat).copy()).unflatten(0, batch)

    def write_goal(self, codes, goals):
        written = {name: part.clone() for name, part in codes.items()}
        flat = {k: v.view(-1, *self.shapes[k]).numpy() for k, v in written.items()}
        asked = goals.reshape(-1, goals.shape[-1]).numpy()
        self.goal.write(flat, asked, np.ones(len(asked), np.bool_))
        return written

    @property
    def shapes(self):
        return {name: space.shape for name, space in self.single_observation_space.items()}

    def get_state(self):
        return {"env": self.env.get_state(), "generator": self.generator.get_state()}

    def set_state(self, state):
        self.env.set_state(state["env"])
        self.shown = self.env.observations()
        self.generator.set_state(state["generator"])
