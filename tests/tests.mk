# Test programs, and what runs them. Part of the Makefile.

BENCH := $(call objects,$(wildcard tests/bench/*.c))
# The longest ones come first, so that no processor waits for them at the end.
TESTS := $(addprefix $(BUILD)/tests/accuracy/test_,layers fit paths fit_layers montecarlo lut transport_g derivative)
TESTS += $(filter-out $(TESTS),$(patsubst tests/%.c,$(BUILD)/tests/%,$(wildcard tests/accuracy/test_*.c tests/unit/test_*.c)))
TEST_SUPPORT := $(call objects,$(filter-out $(wildcard tests/*/test_*.c) $(wildcard tests/unit/leaks.c tests/accuracy/rings.c tests/accuracy/truth.c tests/bench/*.c tests/bits/*.c tests/e2e/*.c tests/fuzz/*.c),$(wildcard tests/*/*.c))) $(ISOTROPIC)

# ---- programs ------------------------------------------------------------------------------------

$(TESTS): $(BUILD)/tests/%: $(OBJ)/tests/%.o $(TEST_SUPPORT) $(BUILD)/libdipole.a
# Without the lines of the code, which take a third of the linker's time, and by gold in half of it.
$(TESTS): LIBS = -lcmocka $(TLS_LIBS) $(CORE_LIBS) $(TEST_LIBS) $(if $(SANITIZE),,-Wl,--strip-debug)
$(TESTS): ALL_LDFLAGS = -pthread $(if $(shell command -v ld.gold),-fuse-ld=gold) $(LDFLAGS) $(SANITIZE)
# Memory that nothing can free any more is a failure of the test that lost it. Daemons of tests/e2e load
# scan.so.
$(TESTS) $(BUILD)/leaks/dipole: $(if $(SANITIZE),,$(OBJ)/tests/unit/leaks.o)
$(BUILD)/leaks/scan.so: $(OBJ)/tests/unit/leaks.o
	@mkdir -p $(@D)
	$(Q)$(CC) $(ALL_LDFLAGS) -shared -o $@ $<

# The daemon's cache, input, histograms and Modbus, tested without a daemon, and a worker with clients
# of the test's own.
unit = $(addprefix $(BUILD)/tests/unit/,$(1))
$(call unit,test_cache test_profiles): $(call objects,$(wildcard server/store/*.c) server/observe/stats.c server/options.c)
$(call unit,test_histogram): $(call objects,server/observe/latency.c)
$(call unit,test_input): $(call objects,server/net/buffers.c)
$(call unit,test_modbus): $(call objects,server/net/access.c $(addprefix server/modbus/,codec.c receiver.c))
$(call unit,test_scpi): $(call objects,server/scpi/parse.c)
$(call unit,test_choice test_worker): $(filter-out $(OBJ)/server/main.o,$(SERVER))
$(call unit,test_cache test_profiles test_histogram test_input): TEST_LIBS = $(call libs,libuv)
$(call unit,test_choice test_worker): TEST_LIBS = $(SERVER_LIBS)
$(patsubst %,$(OBJ)/tests/unit/test_%.o,cache choice profiles input worker): EXTRA_CPPFLAGS = $(call cflags,libuv)
$(call unit,test_stop): TEST_LIBS = -Wl,--wrap=solver_stops,--wrap=solver_dense_congruence,--wrap=solver_exitance_at
$(OBJ)/tests/unit/test_modbus.o: EXTRA_CPPFLAGS = $(call cflags,libmodbus)

$(BUILD)/bench: $(BENCH) $(BUILD)/libdipole.a
$(OBJ)/tests/bench/bench_service.o: EXTRA_CPPFLAGS = $(TLS_CFLAGS)
$(BUILD)/bench: LIBS = $(TLS_LIBS) $(CORE_LIBS)

# The daemon, and a test can see how often it takes memory from the heap.
$(BUILD)/dipoled-counting: $(SERVER) $(OBJ)/tests/e2e/count_allocations.o $(BUILD)/libproto.a $(BUILD)/libcore.a
$(BUILD)/dipoled-counting: LIBS = -Wl,--wrap=malloc,--wrap=calloc,--wrap=realloc $(SERVER_LIBS) $(CORE_LIBS)
# The command line, with the library that finds lost memory, and its private daemon without it.
$(BUILD)/leaks/dipole: $(CLI) $(BUILD)/libdipole.a | $(addprefix $(BUILD)/leaks/,dipoled scan.so)
$(BUILD)/leaks/dipole: LIBS = $(call libs,libpng lcms2 expat jansson) $(TLS_LIBS) $(CORE_LIBS)
$(BUILD)/leaks/dipoled:
	@mkdir -p $(@D)
	@ln -sf ../dipoled $@
$(OBJ)/tests/e2e/count_allocations.o: EXTRA_CPPFLAGS = $(call cflags,libuv)

$(BUILD)/tests/accuracy/truth: $(call objects,$(addprefix tests/accuracy/,truth.c forms.c reference_fresnel.c)) $(ISOTROPIC) $(BUILD)/libcore.a
$(BUILD)/tests/accuracy/truth: LIBS = $(CORE_LIBS)
$(BUILD)/tests/accuracy/rings: $(OBJ)/tests/accuracy/rings.o $(TOOLS) $(BUILD)/libcore.a
$(BUILD)/tests/bits: $(OBJ)/tests/bits/bits.o $(BUILD)/libcore.a
$(BUILD)/tests/accuracy/rings $(BUILD)/tests/bits: LIBS = $(CORE_LIBS)

# For clang and its libFuzzer alone: `make fuzz` builds it in a folder of its own.
FUZZ := $(call objects,$(wildcard tests/fuzz/*.c))
$(FUZZ): EXTRA_CPPFLAGS = $(call cflags,libuv libmodbus)
$(BUILD)/fuzz: $(FUZZ) $(filter-out %/main.o %/cli/complete.o,$(SERVER) $(CLI)) $(BUILD)/libdipole.a
$(BUILD)/fuzz: LIBS = -fsanitize=fuzzer $(SERVER_LIBS) $(call libs,libpng lcms2 expat jansson) $(CORE_LIBS)

PROGRAMS += $(TESTS) $(addprefix $(BUILD)/,bench dipoled-counting leaks/dipole fuzz tests/bits tests/accuracy/truth tests/accuracy/rings)

# Debian's prometheus and promtool, taken out of the package: installing that would start a server.
# The tests that need them say so if they are not to be had.
$(BUILD)/prometheus:
	@mkdir -p $(@D)/prometheus.d
	-@if command -v prometheus >/dev/null; then ln -sf "$$(command -v prometheus)" "$$(command -v promtool)" $(@D); \
	  elif command -v apt-get >/dev/null; then cd $(@D)/prometheus.d && apt-get -qq -o APT::Sandbox::User=root download prometheus && \
	  dpkg-deb --fsys-tarfile prometheus_*.deb | tar -x ./usr/bin && mv -f usr/bin/promtool usr/bin/prometheus ..; fi
	@rm -rf $(@D)/prometheus.d

# ---- what `make check` runs, and longer forms ------------------------------------------------------

.PHONY: check-programs check-nightly check-ci check-structure check-types check-unit check-stacks check-units-long check-bits \
	check-bits-aarch64 check-e2e check-again check-packages check-soak check-soak-long check-tls-long \
	check-services check-balancer-long check-blender check-figures check-plan plan scaling farm-day check-pipeline check-asan check-tsan check-fuzz \
	check-fuzz-long check-truth check-truth-long check-fits check-varying check-rings rings soak truth \
	fuzz fuzz-merge bench

check-programs: $(filter-out %/fuzz,$(PROGRAMS)) $(BUILD)/wire-lists ## every program compiles, but for the fuzzer

# What .ci/run runs after `make check`, and what else takes long. `make check-PART` runs one of them.
CI_PARTS := bits-aarch64 pipeline soak-long services+fuzz stacks packages deb
NIGHTLY_PARTS := $(filter-out stacks,$(CI_PARTS)) tls-long balancer-long+rings,truth-long plan figures fits+varying units-long fuzz-long blender
check-ci: PARTS ?= $(CI_PARTS)
check-nightly: PARTS ?= $(NIGHTLY_PARTS)
check-ci: ## packages in a new system, aarch64, long loads
check-nightly: ## all that takes long, or PARTS of it; build/logs-nightly/ran says what ran when
check-ci check-nightly:
	@sh .ci/install-packages demo check deb ci
	@$(MAKE) --no-print-directory -j2 all $(BUILD)/tests/bits
	+@bash tests/run-check.sh $(BUILD)/logs-nightly $(PARTS); status=$$?; \
	  echo "---- when each part ran last"; column -t $(BUILD)/logs-nightly/ran; exit $$status

check-structure: ## circles of modules, words of documents
	@$(PYTHON) tests/structure.py

check-types: ## types of the Python module and of the examples in Python
	@MYPYPATH=clients/python:clients/modbus $(PYTHON) -m mypy --strict --enable-incomplete-feature=Unpack --cache-dir $(BUILD)/mypy clients/python/dipole clients/python/examples clients/modbus

# Each test program by itself, so that one that crashes takes no other with it.
# Some solve for ten seconds to a minute; tests/bits and the campaign of `make truth` have stacks,
# solutions by g and derivatives, too.
STACKS := $(if $(SANITIZE),,$(addprefix $(BUILD)/tests/accuracy/test_,layers fit_layers transport_g derivative))
SHORT_TESTS := $(filter-out $(STACKS),$(TESTS))
check-unit: $(SHORT_TESTS) ## tests in C
	@UNIT_LIMIT_S=$(UNIT_LIMIT_S) bash tests/run-units.sh $(BUILD)/logs $(SHORT_TESTS)

check-stacks: $(STACKS)
	@bash tests/run-units.sh $(BUILD)/logs-nightly $(STACKS)

# Those that have a long form.
LONG_TESTS := $(patsubst tests/%.c,$(BUILD)/tests/%,$(wildcard tests/accuracy/test_*.c) $(shell grep -l unit_is_long tests/unit/test_*.c))
check-units-long: $(LONG_TESTS)
	@UNIT_LONG=yes bash tests/run-units.sh $(BUILD)/logs-nightly $(LONG_TESTS)

check-bits: $(BUILD)/tests/bits $(BUILD)/leaks/scan.so ## the recorded bits from each instruction set
	@PORTABLE_LOADS=$(if $(SANITIZE),,$(abspath $(BUILD))/leaks/scan.so) sh tests/run-bits.sh $(BUILD) native

check-bits-aarch64: $(BUILD)/tests/bits
	@sh tests/run-bits.sh $(BUILD) aarch64

PYTEST = env TESTED_BUILD=$(abspath $(BUILD)) PYTHONPATH=clients/python:tests/e2e PYTHONDONTWRITEBYTECODE= PYTHONPYCACHEPREFIX=$(abspath $(BUILD))/pycache $(PYTHON) -m pytest -q -rfEs -p no:cacheprovider

# Those that need much beside the programs: a browser, systemd, containers, HAProxy, masters of Modbus.
SERVICES := $(addprefix tests/e2e/test_,balancer.py container.py install.py modbus_clients.py page.py robustness.py)
check-services: all ## clients and systems of others around the programs
	$(PYTEST) -n 2 --dist loadfile --durations=20 $(SERVICES)

# Those that parts of `make check-ci` and `make check-nightly` run.
APART := $(SERVICES) $(addprefix tests/e2e/test_,packages.py pipeline.py figures.py plan.py)
check-e2e: all $(addprefix $(BUILD)/,dipoled-counting leaks/dipole) ## tests of the programs
	$(PYTEST) -n 3 --dist loadfile --durations=20 $(APART:%=--ignore=%) tests/e2e

# Runs the one test of tests/e2e that the variable TEST of the environment names.
check-again:
	@$(PYTEST) "$$TEST"

# Builds the Debian packages twice.
check-packages: all
	$(PYTEST) tests/e2e/test_packages.py

check-soak: all
	SOAK_S=15 $(PYTEST) -s tests/soak

check-soak-long: all
	SOAK_S=120 $(PYTEST) -s tests/soak

# Ten thousand handshakes that somebody leaves half open, five thousand with faults, and a million
# records with faults.
check-tls-long: all
	TLS_HANDSHAKES=10000 TLS_RECORDS=1000000 $(PYTEST) --durations=5 tests/e2e/test_tls.py

# Clients of all kinds behind HAProxy, while three daemons are killed and drained.
BALANCER_S ?= 600
check-balancer-long: all ## ten minutes behind HAProxy, BALANCER_S seconds if given
	BALANCER_S=$(BALANCER_S) $(PYTEST) -k all_kinds tests/e2e/test_balancer.py

check-blender: all ## colours in Debian's Blender (500 MB of packages)
	@sh .ci/install-packages blender
	$(PYTEST) -s tests/blender

# PLAN='--nodes 2e3 --rate 50' for another farm. `make scaling` puts the tables into
# server/DEPLOYING.md. check-plan compares the simulation with three daemons.
PLAN_COMMAND = env TESTED_BUILD=$(abspath $(BUILD)) PYTHONPATH=clients/python PYTHONDONTWRITEBYTECODE=1 $(PYTHON) tests/plan.py
plan: all ## how many daemons and how much network a farm needs
	@$(PLAN_COMMAND) $(PLAN)

scaling: all
	@$(PLAN_COMMAND) $(PLAN) --write server/DEPLOYING.md

farm-day: all ## frames an hour by eight clients and three daemons behind HAProxy, and at home (a minute)
	@sh .ci/install-packages
	@env TESTED_BUILD=$(abspath $(BUILD)) PYTHONPATH=clients/python PYTHONDONTWRITEBYTECODE=1 $(PYTHON) tests/farm_day.py

check-plan: all
	@$(PLAN_COMMAND) --check
	$(PYTEST) tests/e2e/test_plan.py

# Figures and tables of the models, as `make figures` and `make tradeoff` draw them.
check-figures: all
	$(PYTEST) tests/e2e/test_figures.py

# Eight connections, each with 256 requests under way.
PIPELINE_REQUESTS ?= 10000000
check-pipeline: ## 10 million requests on eight connections, each answer compared
	@sh .ci/install-packages
	@$(MAKE) --no-print-directory -j2 all
	PIPELINE_REQUESTS=$(PIPELINE_REQUESTS) $(PYTEST) -s tests/e2e/test_pipeline.py

SOAK_S ?= 600
soak: ## ten minutes at full load, SOAK_S seconds if given: answers and memory
	@sh .ci/install-packages
	@$(MAKE) --no-print-directory -j2 all
	SOAK_S=$(SOAK_S) $(PYTEST) -s tests/soak

SANITIZE_asan := address,undefined -fno-sanitize-recover=all
SANITIZE_tsan := thread
check-asan: ## check with the sanitizers of addresses and undefined behaviour
check-tsan: ## check with the sanitizer of threads
check-asan check-tsan: check-%:
	@sh .ci/install-packages
	@$(MAKE) --no-print-directory build/libdipole.so
	@$(MAKE) --no-print-directory BUILD=build-$* SANITIZE='-fsanitize=$(SANITIZE_$*)' CFLAGS='-O1 -g' UNIT_LIMIT_S=3600 check

# With sanitizers, clang cannot vectorize each loop that is marked for it.
BUILT_FUZZ = build-fuzz
BUILD_FUZZ = $(MAKE) --no-print-directory -j2 BUILD=$(BUILT_FUZZ) CC=clang CFLAGS='-O1 -gline-tables-only -Wno-pass-failed' SANITIZE='-fsanitize=fuzzer-no-link -fsanitize=address,undefined -fno-sanitize-recover=all' $(BUILT_FUZZ)/fuzz
# The corpus, and so many seconds of other inputs for each target, at most. The short form builds
# portable kernels alone, which takes half the time.
check-fuzz: FUZZ_S = 4
check-fuzz: BUILT_FUZZ = build-fuzz-portable
check-fuzz: BUILD_FUZZ += ISAS=portable
check-fuzz-long: FUZZ_S = 5
check-fuzz check-fuzz-long:
	@if ! command -v clang >/dev/null; then echo "fuzz: everything was skipped: there is no clang"; exit 0; fi; \
	  $(BUILD_FUZZ) && $(PYTHON) tests/fuzz/fuzz.py $(BUILT_FUZZ)/fuzz check $(FUZZ_S)

fuzz: ## libFuzzer for SECONDS=300 on all that reads foreign bytes, with sanitizers
	@sh .ci/install-packages
	@$(BUILD_FUZZ)
	@$(PYTHON) tests/fuzz/fuzz.py build-fuzz/fuzz $(or $(SECONDS),300)

# Puts what `fuzz` has found into tests/fuzz/corpus, as far as it reaches new code.
fuzz-merge:
	@$(BUILD_FUZZ)
	@$(PYTHON) tests/fuzz/fuzz.py build-fuzz/fuzz merge

# A fixed seed. The long form has as many rounds as each class needs.
check-truth: ROUNDS = 10
check-truth-long: ROUNDS = 32
check-truth check-truth-long: $(BUILD)/tests/accuracy/truth
	@$(BUILD)/tests/accuracy/truth --rounds $(ROUNDS) --seed 1

truth: $(BUILD)/tests/accuracy/truth ## stated errors against exact values, SECONDS=60 of them, SEED=N or a new one
	$(BUILD)/tests/accuracy/truth --seconds $(or $(SECONDS),60) $(SEED:%=--seed %)

# 100,000 random media and radii for each model, surfaces with tolerance 1e-5 for a grid of 192 pairs
# of g and eta, and 40 media that are solved: some five minutes. Each further solved medium takes two
# seconds.
VARYING_SOLVED ?= 40
check-varying: $(BUILD)/tests/accuracy/test_varying ## media that vary, random ones
	VARYING_MEDIA=100000 VARYING_SURFACES=192 VARYING_SOLVED=$(VARYING_SOLVED) $(BUILD)/tests/accuracy/test_varying

check-fits: $(BUILD)/tests/accuracy/test_fit ## coefficients from 10,000 random sets of readings a model
	FIT_SETS=10000 $(BUILD)/tests/accuracy/test_fit

# MILLIONS of photons for each g.
MILLIONS ?= 100
check-rings: MILLIONS = 4
rings: ## Monte Carlo against the solver, 100 million photons for each g (minutes)
check-rings rings: $(BUILD)/tests/accuracy/rings
	$(BUILD)/tests/accuracy/rings $(MILLIONS)

bench: $(BUILD)/bench ## every benchmark; build/bench GROUP runs one
	$(BUILD)/bench
