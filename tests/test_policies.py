"""Every kind of policy is scored as the same policy written as a function."""

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from gymnasium import spaces
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn

from zipf import envs, evaluate

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
    return evaluate.score(policy, details=True, **PLAY, **SMALL, **options).episodes


# Functions and objects with `predict`


def test_a_function_scores_what_is_known_exactly():
    rng = np.random.default_rng(0)
    scores = evaluate.score(
        lambda observation: rng.integers(8, size=len(observation["image"])),
        split="gridworld",
        episodes=3000,
        seed=2,
    )
    assert list(scores) == [*envs.KINDS]
    for kind, exact in (("train", 0.0324), ("uniform", 0.0477), ("rare", 0.0859)):
        assert abs(scores[kind] - exact) < 4 * np.sqrt(exact * (1 - exact) / 3000)


class Predicting:
    """`Counting` in the convention of Stable-Baselines3."""

    def predict(self, observation, state=None, episode_start=None):
        policy = Counting()
        policy.steps = 0 if state is None else state
        return policy(observation, None, episode_start), policy.steps


def test_an_object_with_predict_keeps_its_state(of_counting):
    assert played(Predicting()).equals(of_counting)


def test_a_policy_of_one_observation():
    def policy(observation):
        assert observation["image"].shape == IMAGE
        return int(scripted({"image": observation["image"][None]})[0])

    single = evaluate.score(policy, episodes=30, seed=4, batched=False, **SMALL)
    predicting = SimpleNamespace(predict=lambda observation, **_: (policy(observation), None))
    batch = evaluate.score(scripted, episodes=30, num_envs=1, seed=4, **SMALL)
    assert single == batch
    assert evaluate.score(predicting, episodes=30, seed=4, batched=False, **SMALL) == batch


def test_what_plays_nothing_is_refused():
    with pytest.raises(TypeError, match="policy is a SimpleNamespace"):
        evaluate.score(SimpleNamespace(), episodes=5)
    with pytest.raises(ValueError, match="deterministic=True"):
        evaluate.score(scripted, deterministic=True)
    with pytest.raises(ValueError, match="batched=False"):
        evaluate.score(Counting(), batched=False)
    with pytest.raises(ValueError, match=r"agent\.zip: should be a \.onnx file"):
        evaluate.score("agent.zip")
    with pytest.raises(ValueError, match=r"agent\.onnx: no such file"):
        evaluate.score("agent.onnx")


@pytest.mark.parametrize(
    ("predict", "options", "error", "message"),
    [
        (lambda seen, **_: scripted(seen), {}, ValueError, r"\(actions, state\), got a ndarray"),
        (lambda seen, **_: None, {}, ValueError, r"return \(actions, state\), got a NoneType"),
        (lambda seen, **_: (None, None), {}, ValueError, "returned object of shape"),
        (lambda seen: None, {}, TypeError, r"take \(observation, state=\.\.\., episode_start="),
        (
            lambda seen, state, episode_start: None,
            {"deterministic": True},
            TypeError,
            r"must take \(observation, .*, deterministic=\.\.\.\): got an unexpected",
        ),
    ],
)
def test_what_predict_takes_and_returns_is_told(predict, options, error, message):
    with pytest.raises(error, match=message):
        evaluate.score(SimpleNamespace(predict=predict), **PLAY, **SMALL, **options)


# Spaces and geometry


def declaring(observation_space, action_space=None, **more):
    return SimpleNamespace(
        predict=lambda observation, **_: (scripted(observation), None),
        observation_space=observation_space,
        action_space=action_space or spaces.Discrete(8),
        **more,
    )


def test_declared_spaces_must_be_the_splits():
    box = spaces.Box(0, 255, IMAGE, np.uint8)
    first = spaces.Box(0, 255, (3, 63, 63), np.uint8)
    for same in (box, first):
        assert played(declaring(spaces.Dict({"image": same}))).equals(played(scripted))
    tiles = spaces.Dict({"tiles": spaces.Box(0, 22, (7, 7), np.uint8)})
    with pytest.raises(
        ValueError, match=r"observation space, .*\(7, 7\).* differs .*\(63, 63, 3\)"
    ):
        played(declaring(tiles))
    with pytest.raises(ValueError, match=r"\(72, 96, 3\).* differs .*'gridworld'"):
        played(declaring(spaces.Dict({"image": spaces.Box(0, 255, (72, 96, 3), np.uint8)})))
    with pytest.raises(ValueError, match=r"action space, Discrete\(46\), differs .* Discrete\(8\)"):
        played(declaring(spaces.Dict({"image": box}), spaces.Discrete(46)))


def test_a_policy_of_an_array_is_given_the_only_observation():
    box = spaces.Box(0, 255, IMAGE, np.uint8)
    policy = declaring(box)
    policy.predict = lambda image, **_: (scripted({"image": image}), None)
    assert played(policy).equals(played(scripted))


def test_a_policys_geometry_must_be_the_splits():
    box = spaces.Dict({"image": spaces.Box(0, 255, IMAGE, np.uint8)})
    played(declaring(box, geometry={"num_maps": 5, "num_rooms": (2, 2), "room_size": [3, 3]}))
    with pytest.raises(
        ValueError, match="'gridworld': num_maps=20 of the policy, 5 of gridworld/zipf_2"
    ):
        played(declaring(box, geometry={"num_maps": 20}))
    with pytest.raises(ValueError, match="and gridworld/rare has no num_toys"):
        played(declaring(box, geometry={"num_toys": 20}))


def test_geometry_has_the_defaults():
    found = evaluate.geometry("gridworld", num_rooms=(2, 2))
    assert list(found) == [one.name for one in envs.split("gridworld").all_levels]
    assert found["gridworld/rare"]["num_maps"] == 20
    assert found["gridworld/rare"]["num_rooms"] == [2, 2]
    own = envs.SplitLevel(lambda n, **o: envs.make_vec("gridworld/rare", n, **o), options=SMALL)
    split = envs.Split("mine", own, "gridworld/uniform", "gridworld/rare")
    found = evaluate.geometry(split, render_mode="rgb_array")
    assert found[own.name] == {**SMALL, "num_rooms": [2, 2]}


# Stable-Baselines3


def test_models_of_stable_baselines3():
    sb3 = pytest.importorskip("stable_baselines3")
    contrib = pytest.importorskip("sb3_contrib")
    from zipf.adapters.stable_baselines3 import ZipfVecEnv

    env = ZipfVecEnv(envs.make_vec("gridworld/zipf_2", 2, **TILES))
    ppo = sb3.PPO("MultiInputPolicy", env, n_steps=8, batch_size=16, seed=0)
    recurrent = contrib.RecurrentPPO(
        "MultiInputLstmPolicy",
        env,
        n_steps=8,
        batch_size=16,
        seed=0,
        policy_kwargs={"lstm_hidden_size": 8, "net_arch": []},
    )
    for model in (ppo, recurrent):
        before = torch.get_rng_state()
        first = evaluate.score(model, details=True, **PLAY, **TILES).episodes
        assert torch.equal(torch.get_rng_state(), before)
        torch.manual_seed(99)
        assert evaluate.score(model, details=True, **PLAY, **TILES).episodes.equals(first)
        best = evaluate.score(model, deterministic=True, details=True, **PLAY, **TILES).episodes
        assert not best.equals(first)
        with pytest.raises(
            ValueError, match=r"tiles.* differs from that of split 'gridworld', .*image"
        ):
            evaluate.score(model, episodes=5, **SMALL)
    states = [None]

    def predict(observation, state, episode_start):
        if states[-1] is None or state is None:
            assert episode_start.all()
        else:
            np.testing.assert_array_equal(state, states[-1])
        action, state = recurrent.predict(observation, state, episode_start)
        states.append(state)
        return action, state

    assert evaluate.score(SimpleNamespace(predict=predict), **PLAY, **TILES)
    assert states[-1][0].shape == (1, 8, 8)


def test_a_model_on_images_that_it_transposes(tmp_path):
    sb3 = pytest.importorskip("stable_baselines3")
    from zipf.adapters.stable_baselines3 import ZipfVecEnv

    env = ZipfVecEnv(envs.make_vec("gridworld/zipf_2", 2, **SMALL))
    model = sb3.PPO("MultiInputPolicy", env, n_steps=8, batch_size=16, seed=0)
    model.geometry = {"num_maps": 5}
    model.save(tmp_path / "model")
    loaded = sb3.PPO.load(tmp_path / "model")
    evaluate.score(loaded, **PLAY, **SMALL)
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
    assert played(module).equals(of_counting)
    assert module.training


def test_actions_of_a_tensordict_module_may_be_one_hot(of_counting):
    indices = counting_module(out="index")
    for out in (lambda index: nn.functional.one_hot(index, 8), lambda index: index.unsqueeze(-1)):
        head = TensorDictModule(out, in_keys=["index"], out_keys=["action"])
        assert played(TensorDictSequential(indices, head)).equals(of_counting)
    wrong = TensorDictModule(
        lambda index: nn.functional.one_hot(index, 8) * 2, in_keys=["index"], out_keys=["action"]
    )
    with pytest.raises(ValueError, match="not one-hot"):
        played(TensorDictSequential(indices, wrong))


def test_the_only_observation_may_be_called_observation():
    module = TensorDictModule(
        lambda image: torch.from_numpy(scripted({"image": image.numpy()})),
        in_keys=["observation"],
        out_keys=["action"],
    )
    assert played(module).equals(played(scripted))


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
    episodes = evaluate.score(policy, deterministic=True, details=True, **PLAY, **TILES).episodes
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
    drawn = evaluate.score(policy, details=True, **PLAY, **TILES).episodes
    assert not drawn.equals(episodes)
    torch.manual_seed(99)
    assert evaluate.score(policy, details=True, **PLAY, **TILES).episodes.equals(drawn)


def test_a_tensordict_modules_spec_must_fit():
    from torchrl.data import Categorical, OneHot

    for spec in (Categorical(8), OneHot(8)):
        evaluate.score(actor(lstm=False, spec=spec), **PLAY, **TILES)
    for spec in (Categorical(46), OneHot(46)):
        with pytest.raises(ValueError, match=r"spec has 46 actions.* Discrete\(8\)"):
            evaluate.score(actor(lstm=False, spec=spec), **PLAY, **TILES)


def test_what_a_tensordict_module_cannot_read_is_told():
    with pytest.raises(ValueError, match="'tiles', which is no observation"):
        played(actor())
    with pytest.raises(ValueError, match="'steps' has no declared shape"):
        played(counting_module(TensorDictModule))
    with pytest.raises(ValueError, match="should write 'action'"):
        played(counting_module(out="index"))
    with pytest.raises(ValueError, match="batched=False"):
        played(counting_module(), batched=False)
    module = counting_module()
    module.geometry = {"max_steps": 100}
    with pytest.raises(ValueError, match="max_steps=100 of the policy, 20 of"):
        played(module)


# TorchScript, which PyTorch has deprecated and many people still use

torchscript = pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")


class Stateful(CountingNetwork):
    @torch.jit.export
    def initial_state(self, num_envs: int) -> list[torch.Tensor]:
        return [torch.zeros(num_envs, 1, dtype=torch.int64)]


def scripted_file(path, module, **geometry):
    torch.jit.save(
        torch.jit.script(module), path, _extra_files={"geometry.json": json.dumps(geometry)}
    )
    return path


@torchscript
def test_a_torchscript_file_keeps_its_state(tmp_path, of_counting):
    path = scripted_file(tmp_path / "agent.pt", Stateful(), num_maps=5)
    assert played(path).equals(of_counting)
    assert played(str(path)).equals(of_counting)
    with pytest.raises(ValueError, match="num_maps=5 of the policy, 20 of gridworld/zipf_2"):
        evaluate.score(path, **PLAY)


class Alone(nn.Module):
    """Reads the last action and reward, and what begins; returns actions."""

    def forward(self, observation, previous_action, previous_reward, is_first):
        check = torch.all((previous_action == -1) == is_first)
        check = check & torch.all(previous_reward[is_first] == 0)
        action = (observation[:, 31, 31, 0].long() // 16 + previous_action + 1) % 8
        return action if bool(check) else action + 100


@torchscript
def test_a_torchscript_file_is_told_of_the_last_step(tmp_path):
    class Following(Counting):
        def __call__(self, observation, reward, is_first):
            last = np.where(is_first, -1, self.steps)
            self.steps = (observation["image"][:, 31, 31, 0] // 16 + last + 1) % 8
            return self.steps

    path = scripted_file(tmp_path / "agent.ts", Alone())
    assert played(path).equals(played(Following()))


class Logits(nn.Module):
    def forward(self, image):
        return torch.log(torch.arange(1, 9).float() / 36).expand(image.shape[0], 8)


@torchscript
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
    evaluate.score(path, split, episodes=200, **SMALL)
    expected = np.arange(1, 9) / 36
    assert np.abs(counts / counts.sum() - expected).max() < 4 / np.sqrt(counts.sum())
    counts[:] = 0
    evaluate.score(path, split, episodes=20, deterministic=True, **SMALL)
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


class Wide(nn.Module):
    def forward(self, image):
        return torch.zeros(image.shape[0], 46)


class Tiles(nn.Module):
    def forward(self, tiles):
        return torch.zeros(tiles.shape[0], 8)


@torchscript
@pytest.mark.parametrize(
    ("module", "message"),
    [
        (CountingNetwork(), "inputs steps are no observations.* method initial_state"),
        (TwoStates(), "initial_state returns 2 states, but 1 inputs .*: steps"),
        (NoStateOut(), "returns 0 states after the actions; .* are: steps"),
        (Wide(), r"float32 of shape \(8, 46\); should be .* logits of shape \(8, 8\)"),
        (Tiles(), r"no observation among its inputs \(tiles\); the observations are image"),
    ],
)
def test_torchscript_files_that_do_not_fit_are_refused(module, message, tmp_path):
    path = scripted_file(tmp_path / "agent.pt", module)
    with pytest.raises(ValueError, match=rf"agent\.pt: .*{message}"):
        played(path)


def test_a_file_of_weights_is_no_torchscript_module(tmp_path):
    torch.save({"weights": torch.zeros(3)}, tmp_path / "agent.pt")
    with pytest.raises(ValueError, match="is not a TorchScript module"):
        played(tmp_path / "agent.pt")


# ONNX


def onnx_file(path, *, image="UINT8", shape=("n", *IMAGE), state=("n", 1), geometry=None):
    """`CountingNetwork` in ONNX; the image is read as the arguments say."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
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
    if geometry:
        helper.set_model_props(model, {"geometry": json.dumps(geometry)})
    onnx.save(model, path)
    return path


def test_an_onnx_file_keeps_its_state(tmp_path, of_counting):
    path = onnx_file(tmp_path / "agent.onnx", geometry={"num_maps": 5})
    assert played(path).equals(of_counting)
    with pytest.raises(ValueError, match="num_maps=5 of the policy, 20 of gridworld/zipf_2"):
        evaluate.score(path, **PLAY)


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ({"shape": ("n", 72, 96, 3)}, r"uint8 \[N, 72, 96, 3\].* is uint8 \[N, 63, 63, 3\]"),
        ({"image": "FLOAT"}, r"float32 \[N, 63, 63, 3\].* is uint8 \[N, 63, 63, 3\]"),
        ({"shape": (4, *IMAGE)}, "batches of 4 only, and 8 worlds are played; say num_envs=4"),
        ({"state": ("n", "k")}, r"'steps' .* fixed shape after the batch axis"),
    ],
)
def test_onnx_files_that_do_not_fit_are_refused(declared, message, tmp_path):
    path = onnx_file(tmp_path / "agent.onnx", **declared)
    with pytest.raises(ValueError, match=rf"agent\.onnx: .*{message}"):
        played(path)


def test_what_is_no_onnx_model_is_refused(tmp_path):
    pytest.importorskip("onnxruntime")
    (tmp_path / "agent.onnx").write_bytes(b"nothing")
    with pytest.raises(ValueError, match="is not an ONNX model"):
        played(tmp_path / "agent.onnx")


def test_without_onnxruntime_it_is_said_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "agent.onnx").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ImportError, match=r"pip install 'zipf-rl\[onnx\]'"):
        played(tmp_path / "agent.onnx")
