# SPDX-License-Identifier: Apache-2.0
# `make` alone explains the targets.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup demo test test-oldest test-versions faults faults-long lint bench bench-live clean

VENV ?= .venv
VENV_OLDEST ?= .venv-oldest
PYTHON ?= python3.12 python3.11 python3
PYTHON_OLDEST ?= python3.11 $(PYTHON)
ARGS ?=
# Most tests of the node wait for it: two files at a time take half the time, also on two cores.
IN_TWOS := --numprocesses 2 --dist loadfile
test test-oldest: export OPENBLAS_NUM_THREADS := 1

# The tests and the demo talk to this machine only.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
# Messages check what is put in them: without it a wrong type is sent as another number.
test faults faults-long: export ROS_PYTHON_CHECK_FIELDS := 1

# The venv brings its own ROS. A sourced one, or the guard that a program of another venv left in
# the environment, would mix the libraries of two.
ifneq ($(AMENT_PREFIX_PATH)$(_ROS_WHEELS_BOOTSTRAP_COMPLETE),)
unexport LD_LIBRARY_PATH
endif
unexport AMENT_PREFIX_PATH COLCON_PREFIX_PATH PYTHONPATH ROS_DISTRO RMW_IMPLEMENTATION
unexport ROS_LOCALHOST_ONLY ROS_STATIC_PEERS ROS_DISCOVERY_SERVER FASTRTPS_DEFAULT_PROFILES_FILE
unexport FASTDDS_DEFAULT_PROFILES_FILE _ROS_WHEELS_BOOTSTRAP_COMPLETE

define HELP
rpgd_ros: align a motion-capture system with cameras from a walking person

  make demo    simulate a studio recording, play it to the live node, print its error;
               its report is demo_output/result.html
  make test    run the tests             make test ARGS='test/test_layers.py -k edge'
  make faults  all faults and threats with their figures (25 min); make faults-long: an hour more
  make lint    check style and types     (ruff, mypy)
  make bench   measure accuracy and speed
  make bench-live  measure rates, losses and latencies of the live node (6 minutes)
  make clean   remove the virtual environments and everything built

The first of them sets up $(VENV) with Python 3.11 or 3.12 and ROS 2 Jazzy as wheels (600 MB).
What to do then, without ROS installed:

  $(VENV)/bin/simulate --help            make a recording with known truth
  $(VENV)/bin/calibrate_bag --help       calibrate from a rosbag2
  $(VENV)/bin/import_recording --help    make a rosbag2 from the files of a shoot
  $(VENV)/bin/evaluate --help            measure on a published dataset
  $(VENV)/bin/calibrator --help          calibrate live

With ROS 2 Jazzy from apt, put this folder into a workspace's src/ instead:

  pip install --break-system-packages 'rosbags>=0.11.7,<0.12'   # the one dependency not in apt
  rosdep install --from-paths src --ignore-src
  colcon build --packages-select rpgd_ros && source install/setup.bash
  ros2 run rpgd_ros calibrator --ros-args -p rig_file:=rig.yaml
endef
export HELP

help:
	@echo "$$HELP"

setup: $(VENV)/.ready

demo: $(VENV)/.ready
	@$(VENV)/bin/python -m rpgd_ros.apps.demo --output demo_output $(ARGS)

test: $(VENV)/.ready
	@$(VENV)/bin/python -m pytest $(IN_TWOS) $(ARGS)

# The other end of the supported versions, and no ROS: what runs offline must run there too.
test-oldest: $(VENV_OLDEST)/.ready
	@$(VENV_OLDEST)/bin/python -m pytest $(IN_TWOS) -m 'not packaging' $(ARGS)

# The same answers with the newest and the oldest libraries.
test-versions: $(VENV)/.ready $(VENV_OLDEST)/.ready
	@answers=$$(mktemp); trap 'rm -f "$$answers"' EXIT
	@$(VENV)/bin/python test/converged.py >"$$answers"
	@$(VENV_OLDEST)/bin/python test/converged.py "$$answers"

# What the package has to survive, each with its figure; ARGS='12 S5' for some of it.
faults: $(VENV)/.ready
	@$(VENV)/bin/python test/faults.py $(ARGS)

faults-long: $(VENV)/.ready
	@$(VENV)/bin/python test/faults.py --long $(ARGS)

lint: $(VENV)/.ready
	@$(VENV)/bin/ruff check .
	@$(VENV)/bin/ruff format --check .
	@$(VENV)/bin/mypy rpgd_ros test

bench: $(VENV)/.ready
	@$(VENV)/bin/python -m rpgd_ros.apps.bench $(ARGS)

bench-live: $(VENV)/.ready
	@$(VENV)/bin/python -m rpgd_ros.apps.bench_live $(ARGS)

clean:
	rm -rf .venv .venv-oldest build install log dist demo_output *.egg-info \
	    .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find rpgd_ros test -name __pycache__ -prune -exec rm -rf {} +

$(VENV)/.ready: CANDIDATES := $(PYTHON)
$(VENV)/.ready: REQUIRED := -e '.[ros,test,browser,lint,colcon,datasets,cluster,import,report]'
$(VENV)/.ready: setup.py setup.cfg package.xml
	$(make_venv)

$(VENV_OLDEST)/.ready: CANDIDATES := $(PYTHON_OLDEST)
$(VENV_OLDEST)/.ready: REQUIRED := -e '.[test]' -c test/oldest.txt
$(VENV_OLDEST)/.ready: setup.py setup.cfg package.xml test/oldest.txt
	$(make_venv)

# A fresh venv of the first candidate that fits, its stamp touched when all is installed. What pip
# says is pages long: it becomes one line of progress, and its errors where it fails.
define make_venv
@for python in $(CANDIDATES) none; do
    $$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && break || true
done
if [ $$python = none ]; then
    echo 'Found no Python 3.11 or newer among: $(CANDIDATES)' >&2
    echo 'Install one, or name it: make PYTHON=/path/to/python3.12' >&2
    exit 1
fi
echo "Setting up $(@D) with $$($$python --version), a minute or two ..."
$$python -m venv --clear $(@D) || {
    echo "$$python cannot make virtual environments; on Debian and Ubuntu: apt install python3-venv" >&2
    exit 1
}
install() {
    $(@D)/bin/python -m pip --disable-pip-version-check --no-input install $(REQUIRED) 2>&1
}
report() {
    n=0
    while read -r verb name rest; do
        case "$$verb $$name" in
            'Successfully installed') set -- $$rest; done="  installed $$# packages" ;;
            Collecting* | Processing*) n=$$((n + 1)); [ ! -t 1 ] || printf '\r\033[K  %d: %s' $$n "$${name##*/}" ;;
        esac
    done
    [ ! -t 1 ] || printf '\r\033[K'
    echo "$${done:-}"
}
install | tee $(@D)/install.log | report || {
    grep -i '^ *error' $(@D)/install.log || tail -n 20 $(@D)/install.log
    echo 'All of it: $(@D)/install.log' >&2
    exit 1
}
touch $@
endef
.ONESHELL:
