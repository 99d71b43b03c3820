# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0

SHELL := /bin/bash
PYTHON ?= python3
export PYTHON

.PHONY: demo test setup view lint docs clean

demo:  ## set up and run the live demo on the virtual sensor
	./mixtac demo $(ARGS)

test: setup  ## set up and run all tests
	. tools/env.sh && python -m pytest $(ARGS)

setup:  ## environment, ROS 2, workspace; does nothing when nothing changed
	$(PYTHON) tools/setup.py

view:  ## set up, with the live view in a browser (rerun, 500 MB)
	$(PYTHON) tools/setup.py --with view

lint: setup  ## style, types, layers
	. tools/env.sh && tools/lint.sh

docs: setup  ## write config/*.yaml and the tables in docs/ from the code
	. tools/env.sh && python tools/write_reference.py

clean:  ## remove everything that set-up made
	rm -rf .venv .venv-ros build install log
