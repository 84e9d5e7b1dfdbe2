"""Recorder of trajectories of the published Tool Delivery environment for tests: tool_delivery_published.json.

    python record_published.py CHECKOUT OUTPUT

CHECKOUT is one of github.com/yuchen-x/MacDeepMARL (MIT) at commit 3ded791, none of whose code is included. Options are
drawn, in most episodes with a preference for progress, so that both deliveries and failed passes occur.

The file: for each episode a list of option steps, each of
    options    of the two Turtlebots and the Fetchbot, as digits; "-" for an agent whose option continues
    duration   low-level steps
    rewards    other than -1, by the low-level step of the option step: [[3, -11.0]]
    ready      the agents that may choose then, as bits
    seen       the joint observation then, 30 bits, as a hexadecimal number
"""

import json
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np

EPISODES = 120
SEED = 0
BASKET, FOUND = slice(8, 11), 3


def published(checkout):
    """Load the environment class; unneeded imports other than NumPy are replaced by stubs."""
    stand_ins = {
        "IPython": {},
        "IPython.core": {},
        "IPython.core.debugger": {"set_trace": None},
        "gym": {"Env": object},
        "gym.utils": {"seeding": None},
        "gym.spaces": {"Discrete": lambda n: SimpleNamespace(n=n), "MultiBinary": lambda n: SimpleNamespace(n=n)},
    }
    for name, content in stand_ins.items():
        module = sys.modules[name] = ModuleType(name)
        vars(module).update(content)
        package, _, short = name.rpartition(".")
        if package:
            setattr(sys.modules[package], short, module)
    package = sys.modules["published"] = ModuleType("published")
    package.__path__ = [str(checkout / "src" / "rlmamr" / "my_env")]
    from published.osd_ma_single_room import ObjSearchDelivery_v4

    return ObjSearchDelivery_v4


def choose(agent, seen, found, generator):
    """Return an option that makes progress in the task."""
    turtlebot = agent < 2
    if turtlebot:
        return 0 if seen[BASKET].any() else 2
    waiting = np.flatnonzero(seen[2:])
    return 1 + int(generator.choice(waiting)) if len(waiting) and seen[:2].any() else 3 + min(found, 2)


def course(environment, generator):
    """Return the option steps of an episode."""
    seen, ready, options = environment.reset(), [True] * 3, [-1] * 3
    eager, found, over, steps = generator.random() < 0.7, 0, False, []
    while not over:
        words = ""
        for agent in range(3):
            if ready[agent]:
                options[agent] = int(generator.integers(6 if agent == 2 else 3))
                if eager and generator.random() < 0.8:
                    options[agent] = choose(agent, seen[agent], found, generator)
                found += agent == 2 and options[agent] >= FOUND
            words += str(options[agent]) if ready[agent] else "-"
        duration, rewards, ready = 0, [], [False] * 3
        while not (over or any(ready)):
            _, seen, reward, over, ready = environment.step(list(options))
            if reward != -1.0:
                rewards.append([duration, float(reward)])
            duration += 1
        bits = "".join(str(int(bit)) for bit in np.concatenate(seen))
        steps.append([words, duration, rewards, "".join(str(int(r)) for r in ready), f"{int(bits, 2):08x}"])
    return steps


def main():
    environment, generator = published(Path(sys.argv[1])), np.random.default_rng(SEED)
    episodes = [course(environment(), generator) for _ in range(EPISODES)]
    lines = ",\n".join(json.dumps(episode, separators=(",", ":")) for episode in episodes)
    Path(sys.argv[2]).write_text(f"[\n{lines}\n]\n", encoding="utf-8")


if __name__ == "__main__":
    main()
