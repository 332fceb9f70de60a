"""Agents of every library are scored as the same policy written by hand."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from gymnasium import spaces
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn

from zipf import envs, evaluate
from zipf.adapters import torchrl, torchscript
from zipf.envs import family

SMALL = {"num_maps": 5, "num_rooms": (2, 2), "num_objects": 5, "max_steps": 20}
TILES = {**SMALL, "observation": "tiles"}
PLAY = {"episodes": 30, "num_envs": 8, "seed": 4}
IMAGE = (63, 63, 3)


def scripted(observation):
    """Actions from the observation alone."""
    images = observation["image"].reshape(len(observation["image"]), -1)
    return (images.astype(np.int64) * np.arange(images.shape[1])).sum(-1) // 7 % 8


class Counting:
    """Actions from the number of steps since the episode began: a policy with a memory."""

    def start(self, num_envs):
        self.steps = np.zeros(num_envs, np.int64)

    def __call__(self, observation, reward, is_first):
        self.steps = np.where(is_first, 0, self.steps) + 1
        return (self.steps * 3 + observation["image"][:, 31, 31, 0] // 16) % 8


class CountingNetwork(nn.Module):
    """`Counting` as a network: logits that leave no choice, and the next state."""

    def forward(self, image, steps):
        steps = steps + 1
        action = (steps[:, 0] * 3 + image[:, 31, 31, 0] // 16) % 8
        return 1e3 * nn.functional.one_hot(action.long(), 8).float(), steps


@pytest.fixture(scope="module")
def of_counting():
    """The scores of `Counting`; the tests of memories compare with them."""
    scores = evaluate.score(Counting(), details=True, **PLAY, **SMALL)
    assert len(set(scores.episodes["length"])) > 3  # or a memory that is never cleared would pass
    return scores.episodes


def played(policy, **options):
    return evaluate.score(policy, details=True, **{**PLAY, **SMALL, **options}).episodes


# Functions and policies


def test_a_policy_of_one_observation():
    def policy(observation):
        assert observation["image"].shape == IMAGE
        return int(scripted({"image": observation["image"][None]})[0])

    single = evaluate.score(policy, episodes=30, seed=4, batched=False, **SMALL)
    assert single == evaluate.score(scripted, episodes=30, num_envs=1, seed=4, **SMALL)


@pytest.mark.parametrize("made", [Counting(), scripted])
def test_a_policy_may_ask_what_it_is_to_play(made):
    asked = []

    def for_envs(*given):
        asked.append(given)
        return made

    first = played(SimpleNamespace(for_envs=for_envs))
    assert first.equals(played(made))
    played(SimpleNamespace(for_envs=for_envs), seed=5)
    (seen, actions, seed), (*_, other) = asked
    assert seen == spaces.Dict({"image": spaces.Box(0, 255, IMAGE, np.uint8)})
    assert actions == spaces.Discrete(8)
    assert seed != other


def test_what_plays_nothing_is_refused():
    for nothing in (SimpleNamespace(), SimpleNamespace(for_envs=lambda *_: None)):
        with pytest.raises(TypeError, match=r"policy is a .*zipf\.load_agent\(folder\) makes"):
            evaluate.score(nothing, episodes=5)
    for policy in (Counting(), SimpleNamespace(for_envs=lambda *_: scripted), "expert"):
        with pytest.raises(ValueError, match="batched=False"):
            evaluate.score(policy, batched=False)
    for path in ("agent.onnx", Path("runs/demo")):
        with pytest.raises(ValueError, match=rf"policy='{path}': .*or 'expert'.*zipf\.adapters\."):
            evaluate.score(path)


# Constructor options


def test_what_a_policy_was_trained_with_must_be_what_it_plays():
    def policy(observation):
        return scripted(observation)

    policy.env_options = {"num_maps": 5, "num_rooms": (2, 2), "room_size": [3, 3]}
    assert played(policy).equals(played(scripted))
    policy.env_options = {"num_maps": 20}
    with pytest.raises(
        ValueError, match="'gridworld': num_maps=20 of the policy, 5 of gridworld/zipf_2"
    ):
        played(policy)
    levels = envs.split("gridworld")
    own = envs.SplitLevel("gridworld/zipf_2", options={"num_maps": 5})
    twenty = envs.Split("some", own, levels.uniform, levels.rare)
    others = {name: value for name, value in SMALL.items() if name != "num_maps"}
    assert evaluate.score(policy, twenty, episodes=2, **others)
    policy.env_options = {"num_toys": 20}
    with pytest.raises(ValueError, match="and gridworld/zipf_2 has no num_toys"):
        played(policy)


def test_constructor_options_have_the_defaults():
    found = evaluate.env_options("gridworld", num_rooms=(2, 2))
    assert list(found) == [one.name for one in envs.split("gridworld").all_levels]
    assert found["gridworld/rare"]["num_maps"] == 20
    assert found["gridworld/rare"]["num_rooms"] == [2, 2]
    own = envs.SplitLevel(lambda n, **o: envs.make_vec("gridworld/rare", n, **o), options=SMALL)
    split = envs.Split("mine", own, "gridworld/uniform", "gridworld/rare")
    found = evaluate.env_options(split, render_mode="rgb_array")
    assert found[own.name] == {**SMALL, "num_rooms": [2, 2]}


# Stable-Baselines3


@pytest.fixture(scope="module")
def sb3():
    """The adapter."""
    pytest.importorskip("sb3_contrib")
    from zipf.adapters import stable_baselines3

    return stable_baselines3


def ppo(sb3, recurrent=False, policy=None, wrap=lambda env: env, **options):
    import sb3_contrib
    import stable_baselines3

    env = wrap(sb3.ZipfVecEnv(envs.make_vec("gridworld/zipf_2", 2, **options)))
    if recurrent:
        small = {"lstm_hidden_size": 8, "net_arch": []}
        return sb3_contrib.RecurrentPPO(
            "MultiInputLstmPolicy", env, n_steps=8, batch_size=16, seed=0, policy_kwargs=small
        )
    return stable_baselines3.PPO(
        policy or "MultiInputPolicy", env, n_steps=8, batch_size=16, seed=0
    )


@pytest.mark.parametrize("recurrent", [False, True])
def test_models_of_stable_baselines3(sb3, recurrent):
    model = ppo(sb3, recurrent, **TILES)
    before = torch.get_rng_state()
    first = played(sb3.policy(model), **TILES)
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(99)
    assert played(sb3.policy(model), **TILES).equals(first)
    assert not played(sb3.policy(model, deterministic=True), **TILES).equals(first)
    with pytest.raises(ValueError, match=r"space, .*tiles.* differs from the env.*image"):
        played(sb3.policy(model))
    with pytest.raises(TypeError, match="policy is a"):
        played(model)
    with pytest.raises(TypeError, match=r"model is a str; should be one, as PPO\.load"):
        sb3.policy("model.zip")


def test_a_model_that_explores_by_a_schedule_is_played_without(sb3):
    import stable_baselines3

    env = sb3.ZipfVecEnv(envs.make_vec("gridworld/uniform", 2, **TILES))
    model = stable_baselines3.DQN("MultiInputPolicy", env, buffer_size=10, seed=0)
    assert sb3.policy(model).deterministic
    assert not sb3.policy(ppo(sb3, **TILES)).deterministic


def test_a_model_keeps_its_state(sb3, of_counting):
    model = ppo(sb3, **SMALL)
    assert not played(sb3.policy(model)).equals(of_counting)

    def predict(observation, state, episode_start, deterministic):
        policy = Counting()
        policy.steps = 0 if state is None else state
        return policy(observation, None, episode_start), policy.steps

    model.predict = predict
    assert played(sb3.policy(model)).equals(of_counting)


def test_other_action_spaces_are_refused(sb3):
    model = ppo(sb3, **SMALL)
    model.action_space = spaces.Discrete(46)
    with pytest.raises(ValueError, match=r"action space, Discrete\(46\), differs .* Discrete\(8\)"):
        played(sb3.policy(model))


def test_a_model_of_an_array_is_given_the_only_observation(sb3):
    from stable_baselines3.common.vec_env import VecExtractDictObs

    model = ppo(sb3, policy="CnnPolicy", wrap=lambda env: VecExtractDictObs(env, "image"), **SMALL)
    assert isinstance(model.observation_space, spaces.Box)
    model.predict = lambda image, *_: (scripted({"image": image}), None)
    assert played(sb3.policy(model)).equals(played(scripted))


WRAPPINGS = {
    "normalised": lambda sb3, env: sb3.VecNormalize(sb3.VecMonitor(env), clip_obs=1.5),
    "the image": lambda sb3, env: sb3.VecNormalize(sb3.VecExtractDictObs(env, "image")),
    "stacked, normalised": lambda sb3, env: sb3.VecNormalize(sb3.VecFrameStack(env, 3)),
    "normalised, stacked": lambda sb3, env: sb3.VecFrameStack(sb3.VecNormalize(env), 3),
    "stacked images": lambda sb3, env: sb3.VecFrameStack(
        sb3.VecTransposeImage(sb3.VecExtractDictObs(env, "image")), 2
    ),
}


@pytest.mark.filterwarnings("ignore:The environment is already wrapped")
@pytest.mark.parametrize("wrapping", WRAPPINGS)
def test_a_model_sees_what_the_wrappers_of_its_env_show(sb3, wrapping):
    from stable_baselines3.common import vec_env

    policy = "CnnPolicy" if "image" in wrapping else "MultiInputPolicy"
    policy = "MlpPolicy" if wrapping == "the image" else policy
    model = ppo(sb3, policy=policy, wrap=lambda env: WRAPPINGS[wrapping](vec_env, env), **SMALL)
    env, seen = model.get_env(), []
    env.reset()
    for i in range(30):
        env.step(np.full(2, i % 8))
    if normalise := model.get_vec_normalize_env():
        normalise.training = False
    model.predict = lambda given, *_, action_masks=None: (seen.append(given), None)
    batch = envs.make_vec("gridworld/zipf_2", 3, **SMALL)
    policy = sb3.policy(model).for_envs(
        batch.single_observation_space, batch.single_action_space, 0
    )
    policy.start(2)
    env.unwrapped.seed(7)
    expected, (observation, _) = env.reset(), batch.reset(seed=7)
    is_first = np.ones(2, bool)
    ends = 0
    for i in range(50):
        policy({name: value[:2] for name, value in observation.items()}, np.zeros(2), is_first)
        np.testing.assert_equal(seen[-1], expected)
        actions = np.array([i % 8, i * 5 % 8])
        expected, _, is_first, _ = env.step(actions)
        observation, *_ = batch.step(np.append(actions, 0))
        ends += is_first.sum()
    assert ends > 3


def test_a_model_is_scored_with_the_statistics_of_its_env(sb3, tmp_path, caplog):
    from stable_baselines3 import DQN, PPO
    from stable_baselines3.common.vec_env import VecNormalize

    model = ppo(sb3, wrap=VecNormalize, **SMALL)
    model.learn(16)
    statistics = model.get_vec_normalize_env()
    given = []
    model.predict = lambda seen, *_: (given.append(seen) or scripted(seen), None)
    played(sb3.policy(model))
    assert {one["image"].dtype for one in given} == {np.dtype(np.float32)}
    before = statistics.obs_rms["image"].mean.copy()
    played(sb3.policy(model))
    assert np.array_equal(statistics.obs_rms["image"].mean, before)

    del model.predict
    model.save(tmp_path / "model")
    statistics.save(str(tmp_path / "statistics"))
    with pytest.raises(ValueError, match=r"trained under VecNormalize.* PPO\.load\(path, env="):
        played(sb3.policy(PPO.load(tmp_path / "model")))
    batch = sb3.ZipfVecEnv(envs.make_vec("gridworld/zipf_2", 4, **SMALL))
    env = VecNormalize.load(str(tmp_path / "statistics"), batch)
    loaded = sb3.policy(PPO.load(tmp_path / "model", env=env))
    assert played(loaded).equals(played(sb3.policy(model)))

    off_policy = DQN("MultiInputPolicy", batch, buffer_size=10)
    off_policy.learn(4)
    played(sb3.policy(off_policy))
    assert not caplog.messages
    off_policy.save(tmp_path / "off_policy")
    played(sb3.policy(DQN.load(tmp_path / "off_policy")))
    assert "scored without wrappers such as VecNormalize" in caplog.text


def test_what_is_not_known_of_a_models_env_is_refused(sb3, monkeypatch):
    import gymnasium as gym
    from sb3_contrib import MaskablePPO
    from sb3_contrib.common.wrappers import ActionMasker
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    class Halved(VecNormalize): ...

    with pytest.raises(ValueError, match=r"wrapper Halved, .*PPO\.load\(path\)"):
        played(sb3.policy(ppo(sb3, wrap=Halved, **SMALL)))
    monkeypatch.setattr(family, "_FAMILIES", dict(family._FAMILIES))
    envs.register(envs.zipfian("CartPole-v1", over={"max_episode_steps": range(9, 14)}))
    for wrap, made, why in (
        (gym.wrappers.NormalizeObservation, PPO, "Gymnasium's NormalizeObservation"),
        (lambda env: ActionMasker(env, lambda _: np.ones(2)), MaskablePPO, "action_masks allow"),
    ):
        env = DummyVecEnv([lambda wrap=wrap: wrap(gym.make("CartPole-v1"))])
        model = made("MlpPolicy", env, n_steps=8, batch_size=8)
        with pytest.raises(ValueError, match=why):
            evaluate.score(sb3.policy(model), "cartpole", episodes=2)


def test_a_model_on_images_that_it_transposes(sb3, tmp_path):
    model = ppo(sb3, **SMALL)
    model.env_options = {"num_maps": 5}
    model.save(tmp_path / "model")
    loaded = sb3.policy(type(model).load(tmp_path / "model"))
    played(loaded)
    with pytest.raises(ValueError, match="num_maps=5 of the policy, 20 of gridworld/zipf_2"):
        evaluate.score(loaded, **PLAY)


# TensorDict modules


class Count(nn.Module):
    def forward(self, image, steps):
        logits, steps = CountingNetwork()(image, steps)
        return logits.argmax(-1), steps


class CountModule(TensorDictModule):
    def make_tensordict_primer(self):
        from torchrl.data import Composite, Unbounded
        from torchrl.envs import TensorDictPrimer

        return TensorDictPrimer(Composite(steps=Unbounded((1,), dtype=torch.int64)))


def counting_module(kind=CountModule, out="action"):
    return kind(Count(), in_keys=["image", "steps"], out_keys=[out, ("next", "steps")])


def test_a_tensordict_module_keeps_its_state(of_counting):
    module = counting_module()
    module.train()
    module.frozen = nn.Dropout().eval()
    assert played(torchrl.policy(module)).equals(of_counting)
    assert module.training
    assert not module.frozen.training


@pytest.mark.parametrize("default", [lambda: 2, {"steps": lambda: torch.tensor([2])}, 2])
def test_a_recurrent_state_may_begin_with_a_number_or_a_function(default):
    module = counting_module()
    make = module.make_tensordict_primer

    def primer():
        made = make()
        made.default_value = default
        return made

    module.make_tensordict_primer = primer
    policy = torchrl.policy(module)
    policy.states = ["steps"]
    assert policy.initial_state(3)[0].tolist() == [[2], [2], [2]]


def test_actions_of_a_tensordict_module_may_be_one_hot(of_counting):
    indices = counting_module(out="index")
    for out in (lambda index: nn.functional.one_hot(index, 8), lambda index: index.unsqueeze(-1)):
        head = TensorDictModule(out, in_keys=["index"], out_keys=["action"])
        assert played(torchrl.policy(TensorDictSequential(indices, head))).equals(of_counting)
    wrong = TensorDictModule(
        lambda index: nn.functional.one_hot(index, 8) * 2, in_keys=["index"], out_keys=["action"]
    )
    with pytest.raises(ValueError, match="not one-hot"):
        played(torchrl.policy(TensorDictSequential(indices, wrong)))
    between = TensorDictModule(lambda index: index / 8, in_keys=["index"], out_keys=["action"])
    with pytest.raises(ValueError, match="returns float32 actions; should be integers"):
        played(torchrl.policy(TensorDictSequential(indices, between)))


def test_the_only_observation_may_be_called_observation():
    module = TensorDictModule(
        lambda image: torch.from_numpy(scripted({"image": image.numpy()})),
        in_keys=["observation"],
        out_keys=["action"],
    )
    assert played(torchrl.policy(module)).equals(played(scripted))


def actor(lstm=True, **spec):
    from torchrl.modules import LSTMModule, ProbabilisticActor

    torch.manual_seed(0)
    parts = [
        TensorDictModule(
            lambda tiles: tiles.flatten(-2).float() / 22, in_keys=["tiles"], out_keys=["features"]
        )
    ]
    if lstm:
        parts.append(LSTMModule(49, 8, in_key="features", out_key="core"))
    head = nn.Linear(8 if lstm else 49, 8)
    parts.append(
        TensorDictModule(head, in_keys=["core" if lstm else "features"], out_keys=["logits"])
    )
    return ProbabilisticActor(
        TensorDictSequential(*parts),
        in_keys=["logits"],
        distribution_class=torch.distributions.Categorical,
        **spec,
    )


def test_recurrent_actors_of_torchrl():
    """Against the actor unrolled by hand, one episode at a time."""
    from tensordict import TensorDict
    from torchrl.envs.utils import ExplorationType, set_exploration_type

    policy = actor()
    episodes = played(torchrl.policy(policy, deterministic=True), **TILES)
    env = envs.make_vec("gridworld/zipf_2", 1, autoreset_mode="Disabled", **TILES)
    for situation, expected in episodes[episodes["level_kind"] == "train"].groupby(
        ["map", "target"]
    ):
        observation, _ = env.reset(options=dict(zip(("map", "target"), situation, strict=True)))
        state = {
            "recurrent_state_h": torch.zeros(1, 1, 8),
            "recurrent_state_c": torch.zeros(1, 1, 8),
        }
        first, over = True, False
        while not over:
            tiles = torch.from_numpy(observation["tiles"])
            given = {"tiles": tiles, "is_init": torch.tensor([[first]]), **state}
            with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
                output = policy(TensorDict(given, [1]))
            state, first = dict(output["next"].items()), False
            observation, _, terminated, truncated, info = env.step(output["action"].numpy())
            over = bool(terminated | truncated)
        assert (expected["length"] == info["length"][0]).all()
        assert (expected["return"] == info["return"][0]).all()
    drawn = played(torchrl.policy(policy), **TILES)
    assert not drawn.equals(episodes)
    torch.manual_seed(99)
    assert played(torchrl.policy(policy), **TILES).equals(drawn)


def test_an_actor_that_explores_by_a_schedule_is_played_without():
    from tensordict.nn import TensorDictSequential
    from torchrl.data import Categorical
    from torchrl.modules import EGreedyModule, QValueModule

    class ThirdAction(nn.Module):
        def forward(self, tiles):
            return torch.eye(8)[3].expand(*tiles.shape[:-2], 8)

    greedy = [
        TensorDictModule(ThirdAction(), ["tiles"], ["action_value"]),
        QValueModule(action_space="categorical", spec=None),
    ]
    explores = EGreedyModule(spec=Categorical(8), eps_init=0.9, eps_end=0.05)
    policy = torchrl.policy(TensorDictSequential(*greedy, explores))
    without = torchrl.policy(TensorDictSequential(*greedy))
    assert played(policy, **TILES).equals(played(without, **TILES))


def test_a_tensordict_modules_spec_must_fit():
    from torchrl.data import Categorical, OneHot

    for spec in (Categorical(8), OneHot(8)):
        played(torchrl.policy(actor(lstm=False, spec=spec)), **TILES)
    for spec in (Categorical(46), OneHot(46)):
        with pytest.raises(ValueError, match=r"spec has 46 actions.* Discrete\(8\)"):
            played(torchrl.policy(actor(lstm=False, spec=spec)), **TILES)


def test_what_a_tensordict_module_cannot_read_is_told():
    with pytest.raises(ValueError, match=r"no observation among its inputs \(tiles,.* are image"):
        played(torchrl.policy(actor()))
    unknown = TensorDictModule(Count(), in_keys=["image", "steps"], out_keys=["action", "steps"])
    with pytest.raises(ValueError, match=r"reads 'steps', which is no .* to \('next', 'steps'\)"):
        played(torchrl.policy(unknown))
    with pytest.raises(ValueError, match="'steps' has no declared shape"):
        played(torchrl.policy(counting_module(TensorDictModule)))
    with pytest.raises(ValueError, match="should write 'action'"):
        torchrl.policy(counting_module(out="index"))
    with pytest.raises(TypeError, match="module is a Linear; should be a TensorDictModule"):
        torchrl.policy(nn.Linear(1, 8))
    with pytest.raises(TypeError, match=r"policy is a CountModule; .* torchrl"):
        played(counting_module())
    module = counting_module()
    module.env_options = {"max_steps": 100}
    with pytest.raises(ValueError, match="max_steps=100 of the policy, 20 of"):
        played(torchrl.policy(module))


# TorchScript, which PyTorch has deprecated and many people still use

deprecated = pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")


class Stateful(CountingNetwork):
    @torch.jit.export
    def initial_state(self, num_envs: int) -> list[torch.Tensor]:
        return [torch.zeros(num_envs, 1, dtype=torch.int64)]


def scripted_file(path, module, **options):
    extra = {"env_options.json": json.dumps(options)}
    torch.jit.save(torch.jit.script(module), path, _extra_files=extra)
    return path


@deprecated
def test_a_torchscript_file_keeps_its_state(tmp_path, of_counting):
    path = scripted_file(tmp_path / "agent.pt", Stateful(), num_maps=5)
    policy = torchscript.policy(str(path))
    assert played(policy).equals(of_counting)
    with pytest.raises(ValueError, match="num_maps=5 of the policy, 20 of gridworld/zipf_2"):
        evaluate.score(policy, **PLAY)


class Alone(nn.Module):
    """Reads the last action and reward, and what begins; returns actions."""

    def forward(self, observation, previous_action, previous_reward, is_first):
        check = torch.all((previous_action == -1) == is_first)
        check = check & torch.all(previous_reward[is_first] == 0)
        action = (observation[:, 31, 31, 0].long() // 16 + previous_action + 1) % 8
        return action if bool(check) else action + 100


@deprecated
def test_a_torchscript_file_is_told_of_the_last_step(tmp_path):
    class Following(Counting):
        def __call__(self, observation, reward, is_first):
            last = np.where(is_first, -1, self.steps)
            self.steps = (observation["image"][:, 31, 31, 0] // 16 + last + 1) % 8
            return self.steps

    path = scripted_file(tmp_path / "agent.ts", Alone())
    assert played(torchscript.policy(path)).equals(played(Following()))


class Logits(nn.Module):
    def forward(self, image):
        return torch.log(torch.arange(1, 9).float() / 36).expand(image.shape[0], 8)


class Learned(nn.Module):
    """Has learned its first state; returns actions in eight bits."""

    def __init__(self):
        super().__init__()
        self.first = nn.Parameter(torch.zeros(1))

    def forward(self, image, previous_action, state):
        check = torch.all((previous_action == -1) == (state[:, 0] == 0))
        return (image[:, 31, 31, 0] % 8) if bool(check) else image[:, 0, 0, 0] + 100, state + 1

    @torch.jit.export
    def initial_state(self, num_envs: int) -> list[torch.Tensor]:
        return [self.first.expand(num_envs, 1)]


class NotANumber(nn.Module):
    def forward(self, image):
        return torch.full((image.shape[0], 8), float("nan"))


@deprecated
def test_a_torchscript_file_may_have_learned_its_first_state(tmp_path):
    path = scripted_file(tmp_path / "agent.pt", Learned())
    assert set(evaluate.score(torchscript.policy(path), **PLAY))


@deprecated
def test_logits_that_are_no_numbers_are_refused(tmp_path):
    path = scripted_file(tmp_path / "agent.pt", NotANumber())
    with pytest.raises(ValueError, match=r"its logits are not numbers \(NaN\)"):
        evaluate.score(torchscript.policy(path), **PLAY)


@deprecated
def test_actions_are_drawn_from_logits(tmp_path):
    path = scripted_file(tmp_path / "agent.pt", Logits())
    counts = np.zeros(8)

    def make(num_envs, **options):
        env = envs.make_vec("gridworld/zipf_2", num_envs, **options)
        step = env.step

        def counting(actions, **buffers):
            np.add.at(counts, actions, 1)
            return step(actions, **buffers)

        env.step = counting
        return env

    split = envs.Split("counted", make, "gridworld/uniform", "gridworld/rare")
    evaluate.score(torchscript.policy(path), split, episodes=200, **SMALL)
    expected = np.arange(1, 9) / 36
    assert np.abs(counts / counts.sum() - expected).max() < 4 / np.sqrt(counts.sum())
    counts[:] = 0
    likeliest = torchscript.policy(path, deterministic=True)
    evaluate.score(likeliest, split, episodes=20, **SMALL)
    assert np.flatnonzero(counts).tolist() == [7]


class TwoStates(CountingNetwork):
    @torch.jit.export
    def initial_state(self, num_envs: int) -> list[torch.Tensor]:
        return [torch.zeros(num_envs, 1), torch.zeros(num_envs, 1)]


class NoStateOut(nn.Module):
    def forward(self, image, steps):
        return (image[:, 0, 0, 0].long() + steps[:, 0]) % 8

    @torch.jit.export
    def initial_state(self, num_envs: int) -> list[torch.Tensor]:
        return [torch.zeros(num_envs, 1, dtype=torch.int64)]


class Nested(nn.Module):
    def forward(self, image, steps):
        return torch.zeros(image.shape[0], 8), (steps, steps)

    @torch.jit.export
    def initial_state(self, num_envs: int) -> list[torch.Tensor]:
        return [torch.zeros(num_envs, 1)]


class Halves(nn.Module):
    def forward(self, image):
        return torch.zeros(image.shape[0], 8, dtype=torch.bfloat16)


class Wide(nn.Module):
    def forward(self, image):
        return torch.zeros(image.shape[0], 46)


class Tiles(nn.Module):
    def forward(self, tiles):
        return torch.zeros(tiles.shape[0], 8)


@deprecated
@pytest.mark.parametrize(
    ("module", "message"),
    [
        (CountingNetwork(), "inputs steps are no observations.* method initial_state"),
        (TwoStates(), "initial_state returns 2 states, but 1 inputs .*: steps"),
        (Nested(), "returns tuple among its outputs; should be the actions or logits and each"),
        (NoStateOut(), "returns 0 states after the actions; .* are: steps"),
        (Wide(), r"float32 of shape \(8, 46\); should be .* logits of shape \(8, 8\)"),
        (Tiles(), r"no observation among its inputs \(tiles\); the observations are image"),
    ],
)
def test_torchscript_files_that_do_not_fit_are_refused(module, message, tmp_path):
    path = scripted_file(tmp_path / "agent.pt", module)
    with pytest.raises(ValueError, match=rf"agent\.pt: .*{message}"):
        played(torchscript.policy(path))


@deprecated
def test_logits_may_be_bfloat16(tmp_path):
    played(torchscript.policy(scripted_file(tmp_path / "agent.pt", Halves())))


@deprecated
@pytest.mark.parametrize("options", ["{num_maps", "[5]"])
def test_options_that_are_no_mapping_are_refused(options, tmp_path):
    path = tmp_path / "agent.pt"
    torch.jit.script(Wide()).save(path, _extra_files={"env_options.json": options})
    with pytest.raises(ValueError, match=r"agent\.pt: its env_options should be a JSON object"):
        torchscript.policy(path)


def test_a_file_of_weights_is_no_torchscript_module(tmp_path):
    torch.save({"weights": torch.zeros(3)}, tmp_path / "agent.pt")
    with pytest.raises(ValueError, match=r"agent\.pt: is not a TorchScript module"):
        torchscript.policy(tmp_path / "agent.pt")
    with pytest.raises(ValueError, match=r"none\.pt does not exist"):
        torchscript.policy(tmp_path / "none.pt")


# ONNX


@pytest.fixture(scope="module")
def onnx_policy():
    pytest.importorskip("onnxruntime")
    from zipf.adapters import onnx

    return onnx.policy


def onnx_file(path, *, image="UINT8", shape=("n", *IMAGE), state=("n", 1), **properties):
    """`CountingNetwork` in ONNX; the image is read as the arguments say."""
    onnx = pytest.importorskip("onnx")
    helper, kinds = onnx.helper, onnx.TensorProto
    constants = {
        "one": [1],
        "three": [3],
        "sixteen": [16],
        "eight": [8],
        "from": [31, 31, 0],
        "to": [32, 32, 1],
        "axes": [1, 2, 3],
    }
    nodes = [
        helper.make_node("Add", ["steps", "one"], ["next_steps"]),
        helper.make_node("Slice", ["image", "from", "to", "axes"], ["pixel"]),
        helper.make_node("Cast", ["pixel"], ["number"], to=kinds.INT64),
        helper.make_node("Squeeze", ["number", "axes"], ["red"]),
        helper.make_node("Squeeze", ["next_steps", "one"], ["count"]),
        helper.make_node("Div", ["red", "sixteen"], ["shade"]),
        helper.make_node("Mul", ["count", "three"], ["turned"]),
        helper.make_node("Add", ["shade", "turned"], ["sum"]),
        helper.make_node("Mod", ["sum", "eight"], ["action"]),
    ]
    graph = helper.make_graph(
        nodes,
        "agent",
        [
            helper.make_tensor_value_info("image", getattr(kinds, image), shape),
            helper.make_tensor_value_info("steps", kinds.INT64, state),
        ],
        [
            helper.make_tensor_value_info("action", kinds.INT64, ("n",)),
            helper.make_tensor_value_info("next_steps", kinds.INT64, ("n", 1)),
        ],
        [
            helper.make_tensor(name, kinds.INT64, [len(value)], value)
            for name, value in constants.items()
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {name: json.dumps(one) for name, one in properties.items()})
    onnx.save(model, path)
    return path


def test_an_onnx_file_keeps_its_state(tmp_path, of_counting, onnx_policy):
    policy = onnx_policy(onnx_file(tmp_path / "agent.onnx", env_options={"num_maps": 5}))
    assert played(policy).equals(of_counting)
    with pytest.raises(ValueError, match="num_maps=5 of the policy, 20 of gridworld/zipf_2"):
        evaluate.score(policy, **PLAY)


def test_weights_may_be_in_a_file_beside_it(tmp_path, of_counting, onnx_policy, monkeypatch):
    onnx = pytest.importorskip("onnx")
    model = onnx.load(onnx_file(tmp_path / "whole.onnx"))
    for part in (one for one in model.graph.initializer if one.name in ("three", "eight")):
        part.CopyFrom(onnx.numpy_helper.from_array(onnx.numpy_helper.to_array(part), part.name))
    (tmp_path / "there").mkdir()
    external = {"save_as_external_data": True, "location": "weights", "size_threshold": 0}
    onnx.save(model, tmp_path / "there" / "agent.onnx", **external)
    monkeypatch.chdir(tmp_path)
    assert played(onnx_policy("there/agent.onnx")).equals(of_counting)


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ({"shape": ("n", 72, 96, 3)}, r"uint8 \[N, 72, 96, 3\].* is uint8 \[N, 63, 63, 3\]"),
        ({"image": "FLOAT"}, r"float32 \[N, 63, 63, 3\].* is uint8 \[N, 63, 63, 3\]"),
        (
            {"shape": (4, *IMAGE)},
            r"batches of 4 only, and 8 .* are played; say num_envs=4",
        ),
        ({"state": ("n", "k")}, r"'steps' .* batch axis first and a fixed shape after it"),
        ({"state": (1, "n")}, r"'steps' .* batch axis first and a fixed shape after it"),
    ],
)
def test_onnx_files_that_do_not_fit_are_refused(declared, message, tmp_path, onnx_policy):
    path = onnx_file(tmp_path / "agent.onnx", **declared)
    with pytest.raises(ValueError, match=rf"agent\.onnx: .*{message}"):
        played(onnx_policy(path))


def test_what_is_no_onnx_model_is_refused(tmp_path, onnx_policy):
    (tmp_path / "agent.onnx").write_bytes(b"nothing")
    with pytest.raises(ValueError, match=r"agent\.onnx: is not an ONNX model"):
        onnx_policy(tmp_path / "agent.onnx")
    with pytest.raises(FileNotFoundError, match=r"none\.onnx"):
        onnx_policy(str(tmp_path / "none.onnx"))
