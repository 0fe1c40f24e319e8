"""Other people's learners that `dev.py try` tries, each in an environment of its own."""

import re
from dataclasses import dataclass

PAGE = "docs/stacks.md"
BLOCK = re.compile(r"```(?:text|python)\n(.*?)```", re.DOTALL)
MAKE = 'import usarmjx\n\nenv = usarmjx.make("drive-to-goal", worlds=4, engine="c")\n'
"""The environment that the page's first lines make."""


@dataclass(frozen=True)
class Library:
    """A library that learns in our worlds.

    Attributes:
        title: Its section of the page, whose examples are run one after another.
        distribution: Its name in the package index.
        extras: Ours that bring it.
        requirements: To install beside usarmjx.
        before: Lines that the example needs before it.
        changes: Texts of the example, and others in their place, to make it smaller.
    """

    title: str
    distribution: str
    extras: tuple[str, ...] = ()
    requirements: tuple[str, ...] = ()
    before: str = ""
    changes: tuple[tuple[str, str], ...] = ()

    def program(self, page: str) -> str:
        """Return the program to run: the examples, and a line with the library's version.

        Args:
            page: Text of `PAGE`.
        """
        example = "\n".join(BLOCK.findall(page.split(f"\n## {self.title}\n")[1].split("\n## ")[0]))
        for old, new in self.changes:
            if old not in example:
                raise ValueError(f"the example of {self.title} does not say {old}")
            example = example.replace(old, new)
        last = f'print("{self.distribution}", version("{self.distribution}"))'
        return f"{self.before}{example}\nfrom importlib.metadata import version\n{last}\n"


LIBRARIES = {
    "gymnasium": Library(
        "Gymnasium", "gymnasium", extras=("rl",), before=MAKE, changes=(("num_envs=16", "num_envs=2"),)
    ),
    "sb3": Library("Stable-Baselines3", "stable-baselines3", extras=("rl", "sb3")),
    "pettingzoo": Library("PettingZoo", "pettingzoo", extras=("rl",)),
    "jaxmarl": Library("JaxMARL", "jaxmarl", extras=("rl",), changes=(("64", "2"),)),
    "torchrl": Library("TorchRL", "torchrl", extras=("torchrl",)),
    "benchmarl": Library("BenchMARL", "benchmarl", requirements=("benchmarl==1.5.2",)),
    "brax": Library("Brax", "brax", extras=("train",), before=MAKE),
    "rllib": Library(
        "RLlib", "ray", requirements=("ray[rllib]==2.60.0", "torch==2.15.0", "pettingzoo>=1.27")
    ),
}
"""By the word of `dev.py try --only`; versions are those of CI's job `adapters`."""
