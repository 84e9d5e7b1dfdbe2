"""Step a simulated car with a reward for each second by which it beats its best time to go so far.

python examples/reward_in_gymnasium.py
"""

import gymnasium

import ctrl_rl

value = ctrl_rl.solve("car_ttr", counts=(61, 61, 48))
car = gymnasium.make("sim_bridge.environments:ctrl_rl/car_ttr-v0")
environment = ctrl_rl.TimeToReachReward(car, value, state="state", per_second=300.0)

observation, info = environment.reset(seed=0)
print(f"{len(observation)} numbers observed, true state {info['state'].round(2)}")
total = 0.0
for step in range(20):
    action = environment.action_space.sample()
    observation, paid, terminated, truncated, info = environment.step(action)
    reward = float(paid)
    total += reward
    if step % 5 == 0:
        print(f"step {step}: reward {reward:.2f}, {info['time_to_reach']:.2f} s from the goal at best")
    if terminated or truncated:
        print(f"ended: {info['outcome']}")
        break
print(f"return so far {total:.1f}")
environment.close()
