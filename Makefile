# Everything a newcomer types. `make help` lists it. Nothing is installed twice: the stamps in .venv remember.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip --disable-pip-version-check --quiet
DEMO   ?= runs/demo
# One worker a core, four at the most: more only compile the same numba functions side by side.
WORKERS ?= $(shell n=$$(nproc 2>/dev/null || echo 2); [ $$n -gt 4 ] && echo 4 || echo $$n)

# The pure core: every line and every branch is tested. pyproject.toml forbids the same modules all I/O.
CORE := dispatch dispatch_ugv estimate failsafe fence flightpath gate monitors recovery replanning retime state \
	supervisor turn wake
empty :=
CORE_FILES := $(subst $(empty) ,$(shell printf ','),$(strip $(CORE:%=deploy/%.py)))

.DEFAULT_GOAL := help
.PHONY: help install demo test coverage lint format bench clean

help: ## list the targets
	@grep -hE '^[a-z]+:.*## ' Makefile | sed -E 's/:.*## /\t/' | expand -t 12

$(VENV)/.runtime: pyproject.toml constraints.txt
	@.ci/venv $(VENV) $(PYTHON)
	@echo "installing copcs-deploy into $(VENV) (a few minutes the first time)"
	@$(PIP) install --constraint constraints.txt --editable .
	@echo "compiling the planner and the simulation (once)"
	@$(BIN)/copcs-deploy check mission_configs/lab.yaml >/dev/null 2>&1 || true  # its result does not matter here
	@touch $@

$(VENV)/.dev: $(VENV)/.runtime
	@echo "installing the tools for tests"
	@$(PIP) install --constraint constraints.txt --editable '.[dev]'
	@touch $@

install: $(VENV)/.runtime ## make .venv and install the program into it

demo: $(VENV)/.runtime ## fly the demo mission in simulation; says where report and picture are
	@$(BIN)/copcs-deploy run mission_configs/demo.yaml --out $(DEMO)
	@echo
	@echo "report:  $(DEMO)/report.html"
	@echo "picture: $(DEMO)/picture.png"

test: $(VENV)/.dev ## the default tests, under two minutes
	@$(BIN)/python -m pytest -n $(WORKERS)

coverage: $(VENV)/.dev ## fail unless the pure core is covered to the last branch
	@$(BIN)/python -m pytest -n $(WORKERS) --cov=deploy --cov-branch --cov-report= tests/deploy
	@$(BIN)/python -m coverage report --show-missing --fail-under=100 --include=$(CORE_FILES)

lint: $(VENV)/.dev ## ruff, formatting, mypy, who may import whom
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/python -m mypy
	@$(BIN)/lint-imports

format: $(VENV)/.dev ## put the code into its form
	@$(BIN)/ruff check --fix .
	@$(BIN)/ruff format .

bench: $(VENV)/.dev ## measure: simulation speed, the supervisor's step, the evaluator, the Monte Carlo, the network, pose to command
	@$(BIN)/python -m benchmarks.bench_loop
	@$(BIN)/python -m benchmarks.bench_planner --time 1 --instances 2
	@$(BIN)/python -m benchmarks.bench_montecarlo --runs 0
	@$(BIN)/copcs-deploy benchmark --quick --out runs/benchmark
	@$(BIN)/python -m benchmarks.bench_policy
	@$(BIN)/python -m benchmarks.bench_latency

clean: ## remove the environment, caches and the demo's run folder
	@rm -rf $(VENV) runs/demo build .pytest_cache .mypy_cache .ruff_cache .import_linter_cache htmlcov .coverage
