# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0

SHELL := /bin/bash
PYTHON ?= python3
export PYTHON

.PHONY: demo test clients setup dev view lint docs site clean

demo:  ## set up and run the live demo on the virtual sensor
	./mixtac demo $(ARGS)

test: dev  ## set up and run all tests
	. tools/env.sh && tools/test.sh $(ARGS)

clients: dev  ## show the virtual camera to libcaer; needs umockdev of the system
	$(PYTHON) -m venv .venv-clients
	.venv-clients/bin/pip install --quiet -c constraints.txt numpy event-camera-drivers
	. tools/env.sh && MIXTAC_CLIENT_PYTHON=$(CURDIR)/.venv-clients/bin/python \
		python -m pytest -m umockdev src/mixtac_sim/test/usb $(ARGS)

setup:  ## environment, ROS 2, workspace; does nothing when nothing changed
	$(PYTHON) tools/setup.py

dev:  ## the environment with what tests, checks and training need
	$(PYTHON) tools/setup.py --with learn --with dev

view:  ## set up, with the live view in a browser (rerun, 500 MB)
	$(PYTHON) tools/setup.py --with view

lint: dev  ## style, types, layers
	. tools/env.sh && tools/lint.sh

docs: dev  ## write config/*.yaml and the tables in docs/ from the code
	. tools/env.sh && python tools/write_reference.py

site:  ## the documentation as a site in build/site; warnings are errors
	$(PYTHON) tools/setup.py --with site
	. tools/env.sh && NO_MKDOCS_2_WARNING=1 mkdocs build --strict

clean:  ## remove everything that set-up made
	rm -rf .venv .venv-ros build install log
