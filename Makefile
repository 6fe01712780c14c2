# servolve: every target sets itself up; `make help` lists them.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PACKAGES := controller sim_models evolve deploy firmware_gen servolve
C_FILES := $(wildcard controller/runtime/*.c controller/runtime/*.h sim_models/native/*.c sim_models/native/*.h)
FIRMWARE_C := $(wildcard firmware_gen/runtime/*.[ch] firmware_gen/boards/*/*.[ch] firmware_gen/boards/*/*.cpp)
TESTS_C := $(filter-out tests/golden/%,$(wildcard tests/*.[ch] tests/*/*.[ch]))
OUT ?= demo-out
FUZZ_SECONDS ?= 60

.DEFAULT_GOAL := help
.PHONY: help demo test check format accept fuzz bench clean

help: ## list the targets
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

demo: $(VENV)/ready ## evolve a lamp, transpile it, run it on a virtual rig, compare; leaves $(OUT)/report.html
	$(BIN)/servolve demo --out $(OUT)
	@if [ -n "$$DISPLAY" ] && command -v xdg-open >/dev/null 2>&1; then xdg-open $(OUT)/report.html; fi

test: $(VENV)/ready ## run every test
	$(BIN)/pytest -n 2 --dist loadfile

check: $(VENV)/ready ## lint, types, formats, import directions, docstrings
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/clang-format --dry-run -Werror $(C_FILES) $(FIRMWARE_C) $(TESTS_C)
	$(BIN)/lint-imports
	$(BIN)/python -m controller.generate_runtime --check
	$(BIN)/pytest -q tests/test_docstrings.py

format: $(VENV)/ready ## rewrite the sources in the house's format
	$(BIN)/ruff check --fix
	$(BIN)/ruff format
	$(BIN)/clang-format -i $(C_FILES) $(FIRMWARE_C) $(TESTS_C)

accept: $(VENV)/ready ## what needs a quiet machine or much time: rates, ratios, long random tests
	$(BIN)/pytest tests/accept_*.py
	$(BIN)/pytest --long tests/test_machine_*.py
	$(BIN)/pytest --long tests/test_bits_*.py
	$(BIN)/pytest --fuzz-seconds 600 tests/test_fuzz.py
	$(BIN)/python tests/fuzz_firmware.py --seconds 360 --out build/fuzz
	$(BIN)/servolve bench rollout
	$(BIN)/servolve bench evolve --quick
	$(BIN)/servolve bench bus

fuzz: $(VENV)/ready ## feed the firmware any bytes, FUZZ_SECONDS for each of six targets; leaves build/fuzz
	$(BIN)/python tests/fuzz_firmware.py --seconds $(FUZZ_SECONDS) --out build/fuzz

bench: $(VENV)/ready ## measure speed, as ratios
	$(BIN)/servolve bench

clean: ## remove what was built, keep runs
	rm -rf $(VENV) build $(addsuffix /*.so,$(PACKAGES)) .mypy_cache .ruff_cache .pytest_cache .hypothesis

# the environment, made anew whenever what it is built from changes
$(VENV)/ready: pyproject.toml CMakeLists.txt $(C_FILES)
	@.ci/system-packages
	@test -x $(BIN)/python || { echo "setup: making a virtual environment in $(VENV)/"; $(PYTHON) -m venv $(VENV); }
	@echo "setup: installing servolve (editable) and what it needs into $(VENV)/"
	@$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[sim,report,dev]'
	@touch $@
