"""Policies from any source: a run's folder, an exported file, the package, a baseline, a user's function.

A user's function takes an environment and returns a `Policy`; with an argument, as the folder of a run, it
takes that text too. The folder of the file is searched for modules that it imports.
"""

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.base.settings import parse_assignments
from usarmjx.train.baselines import BASELINES, PLANNERS
from usarmjx.train.baselines.planners import KNOWING, ORACLE, knowing, with_given_messages
from usarmjx.train.envs.env import AgentGroup, Env
from usarmjx.train.envs.membership import building_label, training_note
from usarmjx.train.envs.recipe import TEST, GeneratedArenas
from usarmjx.train.envs.task import ActionArrays, Carry, ObservationArrays, Policy, Task
from usarmjx.train.learning.networks import LearnedPolicy, PolicyParams
from usarmjx.train.make import SourceLoader, check_named, find_baseline, make, make_task, task_values
from usarmjx.train.policies import POLICIES, no_policy
from usarmjx.train.policies.policy_file import NumpyPolicy, weights_in
from usarmjx.train.task_names import newest_name, same_class
from usarmjx.train.tasks.goal_team import GoalTeam

EPISODES, WORLDS = 100, 20
"""Default numbers of episodes and of worlds at once in an evaluation."""


def is_own_policy(what: str) -> bool:
    """Return whether a name is that of a function in a file."""
    return ".py:" in what


def split_own_policy(what: str) -> tuple[str, str, str]:
    """Return file or module, name of the function, and argument; the last is empty without one."""
    name, _, argument = what.partition("@")
    # From the right: a path of Windows has a colon of its own.
    place, _, function = name.rpartition(":")
    return place, function, argument


def own_policy(what: str, env: Env) -> Policy:
    """Return the policy that a user's function makes for an environment.

    Raises:
        UsageError: There is no such function, or it returns something else.
    """
    function, (_, _, argument) = _function(what), split_own_policy(what)
    made = function(env, argument) if argument else function(env)
    if not isinstance(made, Policy):
        raise UsageError(f"policy {what} returned {type(made).__name__}, expected usarmjx's Policy")
    return made


def check_own_policy(what: str) -> None:
    """Import the function that a name stands for.

    Raises:
        UsageError: There is none.
    """
    _function(what)


def _function(what: str) -> Callable[..., object]:
    place, name, _ = split_own_policy(what)
    try:
        module = _module(place)
    except Exception as error:
        raise UsageError(f"policy {what}: cannot be imported: {error}") from error
    function = getattr(module, name, None)
    if not callable(function):
        raise UsageError(f"policy {what}: {place} has no function {name!r}")
    return function


def _module(place: str) -> ModuleType:
    if not place.endswith(".py"):
        return importlib.import_module(place)
    # By contents: a changed file is another module, and two files of one name do not collide.
    known = f"usarmjx_policy_{hashlib.sha256(Path(place).read_bytes()).hexdigest()[:16]}"
    if known not in sys.modules:
        folder = str(Path(place).resolve().parent)
        if folder not in sys.path:
            sys.path.append(folder)  # last, so that it hides no module
        spec = importlib.util.spec_from_file_location(known, place, loader=SourceLoader(known, place))
        assert spec is not None  # as the name ends in .py
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[known] = module  # dataclasses look their module up
        try:
            spec.loader.exec_module(module)
        # A half executed module must not pass for a whole one at the next attempt.
        except BaseException:
            del sys.modules[known]
            raise
    return sys.modules[known]


def zero_policy(env: Env) -> Policy:
    """Return the policy of actions that are all 0."""

    def act(carry: Carry, obs: ObservationArrays, key: jax.Array) -> tuple[Carry, ActionArrays]:
        del key
        sizes = [group.action_size for group in env.groups]
        return carry, tuple(jnp.zeros((*o.shape[:2], n)) for o, n in zip(obs, sizes, strict=True))

    return Policy(initial_carry=_no_memory, act=act)


def random_policy(env: Env) -> Policy:
    """Return the policy of actions that are uniform from -1 to 1, new at each step."""

    def act(carry: Carry, obs: ObservationArrays, key: jax.Array) -> tuple[Carry, ActionArrays]:
        # A key for each group: with one key equal shapes would draw equal actions.
        groups = zip(obs, env.groups, jax.random.split(key, len(obs)), strict=True)
        return carry, tuple(
            jax.random.uniform(k, (*o.shape[:2], group.action_size), minval=-1.0) for o, group, k in groups
        )

    return Policy(initial_carry=_no_memory, act=act)


def _no_memory(worlds: int) -> Carry:
    return jnp.zeros((worlds, 1))


UNTRAINED: Mapping[str, Callable[[Env], Policy]] = {"zero": zero_policy, "random": random_policy}
"""Untrained policies by name."""


def check_untrained(name: str) -> None:
    """Refuse other names.

    Raises:
        UnknownNameError: Lists the names.
    """
    if name not in UNTRAINED:
        raise UnknownNameError(f"no agent {name!r}; known: {', '.join(UNTRAINED)}")


@dataclass(frozen=True, kw_only=True)
class PolicySource:
    """A policy that was found.

    Attributes:
        name: Name in reports.
        task: Name of the task that it is for.
        overrides: Overridden fields of the task in training, as text.
        learned: Its network and weights; None: the baseline of `name`.
        checkpoint: Line about the checkpoint of a run and its choice; else empty.
        named: Whether the user has named the task, so that the code of an own one may be imported.
        parts: Policies of robot classes, by name, where each class has one of its own; else empty.
        untrained: Whether `name` is one of `UNTRAINED`.
        own: Whether `name` is a user's own function, see `is_own_policy`.
    """

    name: str
    task: str
    overrides: Mapping[str, str] = field(default_factory=dict[str, str])
    learned: tuple[LearnedPolicy, PolicyParams] | None = None
    checkpoint: str = ""
    named: bool = False
    parts: Mapping[str, "PolicySource"] = field(default_factory=dict[str, "PolicySource"])
    untrained: bool = False
    own: bool = False

    def for_task(self, task: str) -> "PolicySource":
        """Return the policy for a task that the user has named, an own one in a file or module too.

        Another task has other fields than those that were set in training.
        """
        task = newest_name(task)
        same = same_class(task, self.task)
        return replace(self, task=task, overrides=self.overrides if same else {}, named=True)

    def check_task(self) -> None:
        """Refuse an own task that only the policy's file names; see `make.check_named`.

        Raises:
            UsageError: Says how to name the task.
        """
        if self.own and not self.task:
            raise UsageError(
                f"{self.name} is a function, which is for no task by itself: name it, --task TASK"
            )
        if not self.named:
            check_named(self.task, self.name)

    def policy(self, env: Env) -> Policy:
        """Return the policy for an environment: the most probable actions.

        Robots of a policy that chooses goals send messages by a fixed protocol where they may choose these.

        Raises:
            UsageError: It was trained for other robots, observations or actions.
        """
        if self.parts:
            return mixed_policy(env, self.parts)
        if self.own:
            return own_policy(self.name, env)
        if self.untrained:
            return UNTRAINED[self.name](env)
        if self.learned is None:
            return BASELINES.get(self.name)(env)
        policy, params = self.learned
        # Classes and sizes, not the robots themselves: a policy is shared within a class and plays teams of
        # any size.
        mine, theirs = _shapes(policy.groups), _shapes(env.groups)
        task = getattr(env, "task", None)
        # Trained without messages: the fixed protocol chooses these.
        if isinstance(task, GoalTeam) and task.chooses_messages and mine == _without_messages(task, theirs):
            return with_given_messages(task, policy.as_policy(params))
        if mine != theirs:
            raise UsageError(
                f"{self.name} is for robots (class, numbers in observation and action) {mine}; {env.name} "
                f"as it is set up has {theirs}"
            )
        return policy.as_policy(params)

    def of_class(self, env: Env, group: int) -> Policy:
        """Return the policy for the robots of one group; it takes all observations, and acts for that group.

        Raises:
            UsageError: It has no such robots, or for other observations or actions.
        """
        mine = env.groups[group]
        if self.learned is None:
            whole = self.policy(env)

            def act_alone(carry: Carry, obs: ObservationArrays, key: jax.Array) -> tuple[Carry, ActionArrays]:
                after, actions = whole.act(carry, obs, key)
                return after, (actions[group],)

            return Policy(whole.initial_carry, act_alone)
        policy, params = self.learned
        fits = [g for g, one in enumerate(policy.groups) if _shapes([one]) == _shapes([mine])]
        if not fits:
            raise UsageError(
                f"{self.name} is for robots (class, numbers in observation and action) "
                f"{_shapes(policy.groups)}, which has none like {_shapes([mine])[0]}"
            )
        (index, *_) = fits
        alone = PolicyParams(
            weights=(params.weights[index],), mean=(params.mean[index],), std=(params.std[index],)
        )
        learned = LearnedPolicy((mine,), policy.layers, policy.memory, policy.kind).as_policy(alone)

        def act(carry: Carry, obs: ObservationArrays, key: jax.Array) -> tuple[Carry, ActionArrays]:
            return learned.act(carry, (obs[group],), key)

        return Policy(learned.initial_carry, act)

    def env(
        self,
        settings: Sequence[str] = (),
        *,
        worlds: int = 1,
        engine: str = "auto",
        seed: int = 0,
        split: str | None = None,
    ) -> tuple[Env, Policy, list[str]]:
        """Return its task as it was trained on, the policy for it, and notes on what could not be set so.

        Args:
            settings: Overrides of the task's fields, `key=value` each.
            worlds: Number of worlds.
            engine: `warp`, `jax`, `c`, or `auto`.
            seed: Seed of all random numbers.
            split: Split of generated arenas, a name of `SPLITS`; None: the task's own, used in training. A
                note says if the policy plays buildings of its training.

        Raises:
            UsageError: A setting that does not read, a scene that cannot be built, or that the policy is
                not for; a split of arenas that are not generated; an own task that only the policy's file
                names, see `for_task`.
            UnknownNameError: No such task, or field of it; lists those there are.
        """
        self.check_task()
        # Only after the check: to find an own task is to run its file.
        overrides, notes = task_settings(self.task, self.overrides, settings)
        if split is not None:
            overrides["arena"] = arenas_of(self.task, overrides, split)
        if self.learned is None and self.name == ORACLE:
            knowing(make_task(self.task, **overrides))  # refuses tasks without an oracle
            overrides |= KNOWING
        env = make(self.task, worlds=worlds, engine=engine, seed=seed, **overrides)
        scene = env.scene
        played = (scene.arena,) if scene.arenas is None else scene.arenas.arenas
        seen = self.training_note(map(building_label, played))
        return env, self.policy(env), [*notes, seen] if seen else notes

    def training_note(self, played: Iterable[str]) -> str:
        """Return a warning if the policy was trained in some buildings, by their labels; empty if in none."""
        if self.parts:
            labels = list(played)
            return "; ".join(filter(None, (part.training_note(labels) for part in self.parts.values())))
        if self.learned is None:
            return ""
        # As in training, without the user's settings: those may name other arenas.
        overrides, _ = task_settings(self.task, self.overrides, ())
        return training_note(self.name, make_task(self.task, **overrides).arenas, played)

    def usual_split(self, settings: Sequence[str] = ()) -> str | None:
        """Return the split that it is evaluated on, see `usual_split`.

        Raises:
            UsageError: See `env`.
        """
        self.check_task()
        return usual_split(self.task, task_settings(self.task, self.overrides, settings)[0])

    def amount(
        self, settings: Sequence[str], split: str | None, worlds: int | None, episodes: int | None
    ) -> tuple[int, int]:
        """Return the numbers of worlds and of episodes: as given, or one share for each generated arena.

        Of a split that is one in each; of the task's own as many as make about `EPISODES` together.
        """
        there = self.count_arenas(settings, split)
        # A whole number of episodes in each arena: none counts more than the others.
        usual = there if split is not None else there * round(EPISODES / max(there, 1))
        # `usual` is 0 without generated arenas, and with more than twice `EPISODES` of them.
        episodes = episodes or usual or EPISODES
        return min(worlds or there or WORLDS, episodes), episodes

    def count_arenas(self, settings: Sequence[str], split: str | None) -> int:
        """Return the number of arenas of a split; None: of the task's own, 0 if they are not generated.

        Raises:
            UsageError: See `env`.
        """
        self.check_task()
        overrides, _ = task_settings(self.task, self.overrides, settings)
        if split is not None:
            return arenas_of(self.task, overrides, split).total
        arenas = make_task(self.task, **overrides).arenas
        return arenas.total if isinstance(arenas, GeneratedArenas) else 0


def arenas_of(task: str, overrides: Mapping[str, Any], split: str) -> GeneratedArenas:
    """Return the arenas of a split for a task that is set up so.

    Raises:
        UsageError: Its arenas are not generated.
        UnknownNameError: No such split; lists those there are.
    """
    arenas = make_task(task, **overrides).arenas
    if not isinstance(arenas, GeneratedArenas):
        raise UsageError(f"{task} has no generated arenas as it is set up, so none of the split {split}")
    return arenas.of_split(split)


def usual_split(task: str, overrides: Mapping[str, Any]) -> str | None:
    """Return the split that policies are evaluated on: `test` of generated arenas, None of all others."""
    return TEST if isinstance(make_task(task, **overrides).arenas, GeneratedArenas) else None


def _shapes(groups: Sequence[AgentGroup]) -> list[tuple[str, int, int]]:
    return [(group.name, group.obs_size, group.action_size) for group in groups]


def _without_messages(task: GoalTeam, shapes: list[tuple[str, int, int]]) -> list[tuple[str, int, int]]:
    """Return the shapes of groups as if they chose no messages."""
    seen, done = task.sizes_of_messages
    return [(name, obs - seen, actions - done) for name, obs, actions in shapes]


def task_settings(
    task: str, trained: Mapping[str, str], settings: Sequence[str]
) -> tuple[dict[str, Any], list[str]]:
    """Return the fields of a task from training and overrides, and notes on those left out.

    Descriptions that were set from Python, as `radio=RadioSettings(...)`, cannot be read back. Whatever the
    physics was in training, the reference's is used here by default: scores are compared.

    Args:
        task: Name of the task.
        trained: Fields as the policy was trained, texts by name.
        settings: Overrides of fields, `name=value` each.

    Raises:
        UsageError: A value that is not allowed; names its limits.
        UnknownNameError: No such task, or field; lists those there are.
    """
    chosen, asked = make_task(task), parse_assignments(settings, "--set")
    # A field set as a whole voids what training had set within it; `a.b=` keeps its neighbours.
    replaced = {name.partition(".")[0] for name in asked if "." not in name}
    kept, notes = dict[str, str](), list[str]()
    for name, text in trained.items():
        first = name.partition(".")[0]
        if first == "physics":
            notes.append(f"trained with {name}={text}; here it is the reference's")
        elif not _reads(chosen, name, text):
            notes.append(f"trained with {name}={text}, which is not read back: {task} has its own here")
        elif first not in replaced:
            kept[name] = text
    return task_values(chosen, {**kept, **asked}), notes


def _reads(task: Task, name: str, text: str) -> bool:
    """Return whether a field of a task reads from the text that was kept of it."""
    try:
        task_values(task, {name: text})
    except UsageError:
        return False
    return True


def mixed_policy(env: Env, parts: Mapping[str, PolicySource]) -> Policy:
    """Return the policy in which each class of robots follows one of its own.

    Args:
        env: The environment.
        parts: Policies by class, case ignored. A learned one needs robots of that class, with the same sizes
            of observations and actions, in however large a team.

    Raises:
        UsageError: A class without a policy, a policy without a class, or one that does not fit.
    """
    given = {name.lower(): part for name, part in parts.items()}
    classes = [group.name for group in env.groups]
    # Names on one side only: a class without a policy, or a policy without a class.
    if wrong := sorted({name.lower() for name in classes} ^ {*given}):
        raise UsageError(f"a policy for each of {', '.join(classes)}; missing or unknown: {', '.join(wrong)}")
    policies = [given[name.lower()].of_class(env, index) for index, name in enumerate(classes)]

    def initial_carry(worlds: int) -> Carry:
        return tuple(policy.initial_carry(worlds) for policy in policies)

    def act(carry: Carry, obs: ObservationArrays, key: jax.Array) -> tuple[Carry, ActionArrays]:
        pairs = [policy.act(one, obs, key) for policy, one in zip(policies, carry, strict=True)]
        return tuple(after for after, _ in pairs), tuple(actions[0] for _, actions in pairs)

    return Policy(initial_carry, act)


def _load_parts(what: str, checkpoint: str) -> PolicySource:
    """Return the policy of `CLASS=RUN,CLASS=RUN`; task and settings are those of the first."""
    pairs = [part.partition("=") for part in what.split(",")]
    if wrong := [name + mark + source for name, mark, source in pairs if not (name and source)]:
        raise UsageError(f"{wrong[0]!r} in {what}, expected CLASS=POLICY for each class of robots")
    names = [name.strip().lower() for name, _, _ in pairs]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise UsageError(f"{twice[0]} has two policies in {what}, expected one for each class of robots")
    parts = {name.strip(): load_policy(source.strip(), checkpoint) for name, _, source in pairs}
    first = next(iter(parts.values()))
    lines = [f"{name}: {part.checkpoint}" for name, part in parts.items() if part.checkpoint]
    return replace(first, name=what, learned=None, checkpoint="; ".join(lines), parts=parts)


def load_policy(what: str, checkpoint: str = "best") -> PolicySource:
    """Return the policy of a run's folder, of an exported file, or of the package by its task's name.

    Args:
        what: Folder of a run or of a policy, file, or task; a user's own function, see `is_own_policy`; or
            `CLASS=POLICY,CLASS=POLICY`, one of these for each class of robots.
        checkpoint: Checkpoint of a run: `best`, `last`, or the number of an iteration.

    Raises:
        UsageError: The file or folder holds no run or policy, or is broken.
        UnknownNameError: Nothing is there, and no packaged policy has that name; lists those there are.
    """
    path = Path(what)
    # A file or folder may have = in its name.
    if "=" in what and not path.exists():
        return _load_parts(what, checkpoint)
    if path.is_dir() and (weights := weights_in(path)):
        return replace(load_exported(weights), name=what)
    if path.is_dir():
        # Only here: it imports the learner, which other policies need not have.
        from usarmjx.train.learning.checkpoint import Checkpoints, read_policy

        policy, params, record = read_policy(path, checkpoint)
        return PolicySource(
            name=what,
            task=record.task,
            overrides=record.overrides,
            learned=(policy, params),
            checkpoint=Checkpoints(path).describe(checkpoint),
        )
    # Before files: FILE.py:FUNCTION is no path, and a .py file is no exported policy.
    if is_own_policy(what):
        check_own_policy(what)
        return PolicySource(name=what, task="", own=True)
    if path.exists():
        return load_exported(path)
    name = newest_name(what)
    if name in POLICIES:
        return load_exported(POLICIES.get(name))
    raise UnknownNameError(no_policy(name, POLICIES))


def load_exported(file: Path) -> PolicySource:
    """Return the policy of a file that `usarmjx export` has written.

    Raises:
        UsageError: It is no policy, or broken.
    """
    exported = NumpyPolicy(file)
    given: list[dict[str, Any]] = [
        {**one, "agents": tuple(one["agents"]), "layout": layout, "vector": vector}
        for one, layout, vector in zip(exported.groups, exported.layouts, exported.vectors, strict=True)
    ]
    groups = tuple(AgentGroup(**one) for one in given)
    # Networks over sets call their first layer `own`.
    first = "layer_0" if exported.network == "mlp" else "own"
    names = (first, *(f"layer_{i}" for i in range(1, exported.layers)))
    widths = tuple(exported.weights[0][name]["kernel"].shape[1] for name in names)
    params = PolicyParams(
        weights=tuple({"params": weights} for weights in exported.weights),
        mean=tuple(map(jnp.asarray, exported.mean)),
        std=tuple(map(jnp.asarray, exported.std)),
    )
    learned = LearnedPolicy(groups, widths, exported.memory, exported.network), params
    return PolicySource(name=str(file), task=exported.task, overrides=exported.overrides, learned=learned)


def untrained(name: str, task: str) -> PolicySource:
    """Return the policy without training of a name, for a task.

    Raises:
        UnknownNameError: No such policy; lists those there are.
    """
    check_untrained(name)
    return PolicySource(name=name, task=newest_name(task), named=True, untrained=True)


def baseline(name: str, task: str | None = None) -> PolicySource:
    """Return the baseline of a task, to evaluate on that task or another one.

    Raises:
        UnknownNameError: No such baseline; lists those there are.
        UsageError: An own task that has none, or cannot be imported.
    """
    found = find_baseline(name, task)
    if task is None and found in PLANNERS:
        raise UsageError(f"{found} is a planner of several tasks: name one, --task explore")
    return PolicySource(name=found, task=newest_name(task or found), named=True)
