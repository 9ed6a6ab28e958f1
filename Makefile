# Verbs of the project. `make help` lists them; CI runs `lint` and `test`, a developer `check`.
.DEFAULT_GOAL := help
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.NOTPARALLEL:

PYTHON ?= $(firstword $(foreach p,python3.11 python3.12 python3,$(shell command -v $(p) 2>/dev/null)))
VENV ?= .venv
PY := $(VENV)/bin/python
BUDGET ?= desk
NAME ?= $(BUDGET)
SEEDS ?=
BESIDE ?= 2
# 1: shipped networks in place of trainings that would repeat theirs; several seeds are trained
PRETRAINED ?= $(if $(SEEDS)$(filter thesis,$(BUDGET)),0,1)
ARGS ?=
override export DEMO := $(value DEMO)
TEST_JOBS ?= 2
TORCH_INDEX ?=
BENCHMARKS ?= $(shell grep -l -e '"--quick"' benchmarks/*/*.py)

# One thread a process: more made learning slower beside other work, and sweeps bring their own processes.
export OMP_NUM_THREADS ?= 1

STAGES := $(basename $(notdir $(wildcard conf/stage/*.yaml)))
LEROBOT ?= $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/endonav/lerobot
INSTALLED := $(VENV)/.endonav-installed
INSTALL_INPUTS := constraints.txt requirements.txt pyproject.toml $(wildcard packages/*/pyproject.toml packages/*/setup.py) \
	$(shell find packages/*/src -name '*.c' -o -name '*.h' 2>/dev/null)

CHAIN = $(if $(SEEDS),--seeds $(SEEDS)) $(if $(BESIDE),--beside $(BESIDE))
CHOSEN = budget=$(BUDGET) name=$(NAME) pretrained=$(PRETRAINED) $(ARGS)
GL = MUJOCO_GL=$${MUJOCO_GL:-$$($(PY) pipeline/installation.py gl)}

.PHONY: help setup ray lerobot all smoke demo thesis-check check test lint format bench-quick fuzz docs wheels clean clean-all console $(STAGES)

help:  ## list the verbs
	@echo "make VERB [BUDGET=smoke|desk|thesis] [NAME=run] [ARGS='stage.key=value'] [PYTHON=python3.11]"
	@{ sed -nE 's/^([a-z][a-z0-9_ -]*):.*##[ ]*(.*)/\1@\2/p' $(firstword $(MAKEFILE_LIST)); \
		for stage in $(STAGES); do sed -n "1s/^# */$$stage@stage: /p" conf/stage/$$stage.yaml; done; } \
		| awk -F@ '{ printf "  %-14s %s\n", $$1, $$2 }'

setup: $(INSTALLED)  ## virtual environment, pinned packages, native build, system libraries

$(INSTALLED): $(INSTALL_INPUTS)
	@test -n "$(PYTHON)" || { echo "no Python found: install Python 3.11 or newer, or run make PYTHON=/path/to/python" >&2; exit 1; }
	@$(PYTHON) pipeline/installation.py before --environment $(VENV)
	@test -x $(PY) || $(PYTHON) -m venv $(VENV)
	@echo "installing into $(VENV): some minutes; 3 GB, or 7 with torch for CUDA (make setup TORCH_INDEX=ADDRESS chooses: docs/installation.md)"
	@# Build tools first, pinned like everything else: builds then need no environments of their own.
	@$(PY) -m pip install -qq --disable-pip-version-check -c constraints.txt setuptools hatchling editables mujoco
	@# One build of torch, where it is wanted, from the index that has it; what it needs comes with the rest.
	@$(if $(TORCH_INDEX),$(PY) -m pip install -qq --disable-pip-version-check --no-deps --index-url "$(TORCH_INDEX)" -c constraints.txt torch)
	@# pip would compile on one core.
	@$(PY) -m pip install -qq --disable-pip-version-check --no-compile --no-build-isolation -c constraints.txt -r requirements.txt
	@# Ours, too, where an environment forbids Python to: every start of a stage would compile them again.
	@$(PY) -m compileall -qq -j 0 $(VENV)/lib packages/*/src pipeline >/dev/null 2>&1 || true  # some files of libraries are for other versions
	@echo "source $(VENV)/bin/activate: then python, endonav and examples/ run as the documents write them"
	@touch $@

ray: setup  ## Ray, for a cluster: engine=ray, and sweeps by hydra/launcher=ray; 240 MB more
	@$(PY) -m pip install -qq --disable-pip-version-check --no-build-isolation -c constraints.txt -e .[ray]
	@# Its pins on an old cloudpickle and on cloud services' libraries are needed for none of its local and cluster use.
	@$(PY) -m pip install -qq --disable-pip-version-check --no-deps -c constraints.txt hydra-ray-launcher

lerobot:  ## LeRobot in an environment of its own, which reads exported data sets in a test, 8 GB
	@test -x $(LEROBOT)/bin/python || $(PYTHON) -m venv $(LEROBOT)
	@$(if $(TORCH_INDEX),$(LEROBOT)/bin/python -m pip install -q --disable-pip-version-check --no-deps --index-url "$(TORCH_INDEX)" \
		"torch<2.11" "torchvision<0.26")
	@# and what cathsim needs, which a test of EnvHub's entry imports from this tree
	@$(LEROBOT)/bin/python -m pip install -q --disable-pip-version-check lerobot==0.4.4 mujoco==4.0.0 \
		annotated-types pydantic pyyaml scikit-image scipy trimesh

all: setup  ## every stage, then the report: runs/<name>/report/index.html (PRETRAINED=0: trains what is shipped, too; SEEDS=3: figures over three seeds; BESIDE=1: no two stages at a time)
	@$(GL) $(PY) -m pipeline.chain $(CHAIN) all -- $(CHOSEN)

smoke:  ## the whole chain in minutes; its numbers mean nothing
	@$(MAKE) --no-print-directory all BUDGET=smoke

thesis-check: setup  ## every stage of BUDGET=thesis in minutes, and what each job took (ARGS=stage.device=cuda on a GPU)
	@$(GL) $(PY) -m pipeline.thesis_check $(ARGS)

demo: setup  ## the shipped navigator in an unseen arch, or in yours (DEMO=arch.stl): film, log, page
	@# from the environment, where no sign of a path means anything to make or to the shell
	@$(GL) $(PY) -m pipeline.demo $${DEMO:+--anatomy="$$DEMO"} $(ARGS)

# after the stages that it reads
$(STAGES): setup
	@$(GL) $(PY) -m pipeline.chain $(CHAIN) --inputs $@ -- $(CHOSEN)

console: setup  ## steer the wire yourself, in the browser; episodes go to runs/<name>/human
	@$(PY) -m pipeline.console --name $(NAME) $(ARGS)

check: setup  ## lint, types and fast tests: what to run before each commit
	@$(MAKE) --no-print-directory lint
	@$(GL) $(PY) -m pytest -q -n $(TEST_JOBS) --dist loadfile -m "not slow" $(ARGS)

test: setup  ## all tests, TEST_JOBS=2 beside each other (ARGS go to pytest)
	@# Sweeps over Ray are tested, too; where it cannot be installed, that test is left out.
	@$(PY) -c "import ray, hydra_plugins.hydra_ray_launcher" 2>/dev/null || $(MAKE) --no-print-directory ray \
		|| echo "Ray could not be installed: its tests are left out" >&2
	@$(GL) $(PY) -m pytest -n $(TEST_JOBS) --dist loadfile --no-loadscope-reorder $(ARGS)

lint: setup  ## ruff and mypy
	@$(PY) -m ruff check .
	@$(PY) -m ruff format --check .
	@$(PY) -m mypy

format: setup  ## let ruff format and mend what it can
	@$(PY) -m ruff check --fix .
	@$(PY) -m ruff format .

bench-quick: setup  ## every benchmark that has a quick form and needs nothing else, at most 50 s each (BENCHMARKS='FILE ...')
	@for benchmark in $(BENCHMARKS); do echo "== $$benchmark"; code=0; $(PY) $$benchmark --quick || code=$$?; \
		case $$code in 0) ;; 2) echo "left out: it needs arguments" ;; *) exit $$code ;; esac; done

fuzz: setup  ## damaged files, settings and messages, EXAMPLES=300 of each reader (ARGS='-k models')
	@EXAMPLES=$(or $(EXAMPLES),300) $(PY) -m pytest -q tests/fuzz --hypothesis-profile=fuzz $(ARGS)

docs: setup  ## the documentation site, in site/
	@$(PY) -c "import mkdocs, mkdocstrings" 2>/dev/null || $(PY) -m pip install -qq --disable-pip-version-check \
		--no-build-isolation -c constraints.txt -e .[docs]
	@NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --strict --quiet
	@echo "site/index.html; with search: $(PY) -m http.server -d site"

wheels: setup  ## wheels and sources of all five distributions in dist/, manylinux where auditwheel can
	@$(PY) -m pip install -qq --disable-pip-version-check --no-build-isolation -c constraints.txt -e .[wheels]
	@$(PY) benchmarks/pipeline/wheels.py --output dist $(ARGS)

clean:  ## remove caches and build products; runs and the environment stay
	@find . -path ./$(VENV) -prune -o -type d \( -name __pycache__ -o -name '*.egg-info' \) -prune -exec rm -rf {} +
	@rm -rf .pytest_cache .mypy_cache .ruff_cache build dist site packages/*/build packages/*/dist

clean-all: clean  ## also remove the environment and every run
	@rm -rf $(VENV) runs
