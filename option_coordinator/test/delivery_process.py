"""Test robot as a process: the real agent and the real work of a delivery team; its ways only take time."""

import sys
from pathlib import Path
from typing import ClassVar

import numpy as np
from option_coordinator.nodes.option_agent import STEADY, Clocks
from option_coordinator.protocol.protocol_types import TeamId
from option_coordinator.teams.delivery import Delivery

from ctrl_rl_core import Parameter, SuiteNode, run_node
from option_coordinator import ClientTimeouts, OptionAgent, load_team


class DeliveryRobot(SuiteNode):
    """Robot that is at its option's place after `way` seconds."""

    PARAMETERS: ClassVar = (
        Parameter("robot", "", "Name."),
        Parameter("team", "", "Its team.", kind="path"),
        Parameter("memory", "", "File that keeps its work.", kind="path"),
        Parameter("way", 0.1, "How long each way takes [s]."),
    )

    def __init__(self):
        super().__init__("robot")
        team, name = load_team(self.settings["team"]), self.settings["robot"]
        self.delivery, self.clocks = Delivery(team, name), Clocks(self)
        self.pose, self.began = np.array((*team.robots[name].home, 0.0)), 0.0
        timeouts = ClientTimeouts(heartbeat=0.05, repeat=0.05, waiting=1.0)
        identity, memory = TeamId(team.name, team.digest), Path(self.settings["memory"])
        names = team.option_names
        safe = names.index(team.safe_option)
        self.agent = OptionAgent(self, name, names, self, safe, timeouts, team=identity, memory=memory)
        self.create_timer(0.01, self.work, clock=STEADY)
        self.agent.start()

    def observe(self):
        return self.delivery.see(self.pose)

    def resume(self, work):
        self.delivery.resume(work)

    def begin(self, option):
        self.began = self.clocks().task
        self.delivery.begin(option, self.began)

    def leave(self):
        return self.delivery.leave(self.clocks().task)

    def work(self):
        now = self.clocks().task
        if self.delivery.option is None or now - self.began < self.settings["way"]:
            return
        if self.delivery.place is not None:
            self.pose[:2] = self.delivery.place
        result = self.delivery.at_place(now)
        if result is not None:
            self.agent.ended(*result)


if __name__ == "__main__":
    sys.exit(run_node(DeliveryRobot))
