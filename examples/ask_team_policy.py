"""Query a team's joint policy directly: first for all robots, then for one robot while the others continue.

python examples/ask_team_policy.py
"""

import numpy as np

from option_coordinator import OptionPolicy, make_environment

environment = make_environment("delivery_team")
policy = OptionPolicy.load_for("delivery_team", environment.agents)
generator = np.random.default_rng(0)

decision = environment.reset(seed=0)
total = 0.0
for _ in range(6):
    options = policy.choose(decision, generator)
    names = {agent.name: agent.options for agent in environment.agents}
    running = {name: names[name][option] for name, option in decision.running_options.items()}
    chosen = {name: names[name][option] for name, option in options.items()}
    print(f"ready: {', '.join(decision.ready)}; running: {running or 'nobody'}; chosen: {chosen}")
    decision = environment.step(options)
    total += decision.reward
    print(f"  {decision.duration} low-level steps later a robot is ready; reward {decision.reward:.2f}")
    if decision.over:
        break
print(f"sum of rewards {total:.2f}")
