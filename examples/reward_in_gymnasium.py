"""Step a simulated car that is paid the time to reach (thesis Eq. 3.9) at every step.

python examples/reward_in_gymnasium.py
"""

from ttr_reward_node.training.training import make_rewarded

from ctrl_rl_core import load_navigation_task
from ttr_reward_node import make_reward, problem_from_task, solve

task = load_navigation_task("car_ttr")
value = solve(problem_from_task(task, counts=(61, 61, 48))).grid
environment = make_rewarded(make_reward("ttr", task, value))

observation, info = environment.reset(seed=0)
print(f"{len(observation)} numbers observed, true state {info['state'].round(2)}")
total = 0.0
for step in range(20):
    action = environment.action_space.sample()
    observation, paid, terminated, truncated, info = environment.step(action)
    reward = float(paid)
    total += reward
    if step % 5 == 0:
        print(f"step {step}: reward {reward:.2f}, {-reward:.2f} s from the goal at best")
    if terminated or truncated:
        print(f"ended: {info['outcome']}")
        break
print(f"return so far {total:.1f}")
environment.close()
