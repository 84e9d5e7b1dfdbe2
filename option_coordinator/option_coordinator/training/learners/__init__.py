"""Learners of joint options: MAPPO, Mac-DQN, imitation."""
