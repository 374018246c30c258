# dipoled: `make demo` shows it working, `make check` tests it. Both install what is missing.
#
#   make            the daemon, the client, the libraries, the benchmark, in build/
#   make demo       measured skin, two models, a table and two pictures
#   make check      all tests that take minutes; check-asan and check-tsan: under sanitizers
#   make check-long the tests that take longer: packages in a new system, aarch64, long loads
#   make soak       ten minutes at full load, SOAK_S seconds if given: answers and memory
#   make check-balancer-long  ten minutes behind HAProxy, BALANCER_S seconds if given
#   make check-pipeline  10 million requests from eight threads, each answer compared
#   make truth      stated errors against exact values, SECONDS=60 of them, SEED=N or a new one
#   make rings      Monte Carlo against the solver, 100 million photons for each g (minutes)
#   make fuzz       coverage-guided fuzzing of all that reads foreign bytes, SECONDS=300 of it
#   make plan       how many daemons and how much network a farm needs (server/DEPLOYING.md)
#   make bench      every benchmark; build/bench GROUP runs one
#   make docs       the tables in proto/*.md, from proto/*.def, and the manual pages
#   make gamma-errors  core/gamma_errors.def, transport with gamma for other phase functions
#   make tradeoff   speed against accuracy, in build/tradeoff, and core/costs.def (minutes)
#   make tables     core/transport/transport.table, solved anew (2 hours; resumes)
#   make apertures  core/fit/aperture.table and its errors, solved anew (minutes; resumes)
#   make reference  core/transport/reference.csv, R(r) for many g, solved anew (an hour; resumes)
#   make figures    Figures 1 to 17 of d'Eon 2012 and one of tissue, in build/figures (ten minutes;
#                   resumes), with build/figures/index.html, and core/tools/tissue.svg
#   make picture    a mesh in marble, milk and skin by three models, clients/c/examples/picture.png
#   make gather-figure  build/figures/gather.svg: light gathered from points, error against time
#   make fit-bias   coefficients that diffusion models give, beside those by transport
#   make install    to $(DESTDIR)$(PREFIX); make uninstall takes it away again
#   make container  an image of the daemon, by podman or docker (clients/deploy/Containerfile)
#   make deb        Debian packages, in build/deb; make check-deb installs them in a new system
#   make setup      installs the packages of .ci/packages, nothing else
#   make clean     (V=1 shows the commands of any of these)

PREFIX ?= /usr/local
DESTDIR ?=
BUILD ?= build
PYTHON ?= /usr/bin/python3

VERSION := 0.1.0
SOVERSION := 0

# Short lines; make V=1 shows the commands.
V ?= 0
ifeq ($(V),0)
Q := @
SAY = @echo " " $(1) $(2)
else
Q :=
SAY =
endif

CC ?= cc
ifeq ($(origin CC),default)
CC := cc
endif
CFLAGS ?= -O2 -g
WARNINGS := -Wall -Wextra -Werror -Wshadow -Wstrict-prototypes -Wmissing-prototypes -Wpointer-arith
# -ffp-contract=off: the same bits from every compiler and machine. The two -fno options change no
# value; without them loops with sqrt and selections are not vectorized. GCC 12.2 at -O2 drops the
# rounding of `x[0] = (double)(float)x[0]; x[1] = (double)(float)x[1];` in its SLP vectorizer.
BITS := -ffp-contract=off -fno-math-errno -fno-trapping-math -fno-tree-slp-vectorize
# The x87 of 32-bit machines rounds twice.
ifneq ($(shell $(CC) -dM -E -x c /dev/null | grep -w __i386__),)
BITS += -msse2 -mfpmath=sse
endif
ALL_CFLAGS = -std=c17 $(WARNINGS) $(BITS) -fPIC -pthread $(CFLAGS) $(SANITIZE)
ALL_CPPFLAGS = -D_GNU_SOURCE -I. -DDIPOLED_VERSION='"$(VERSION)"' -MMD -MP $(CPPFLAGS)
# Fuzzing does not follow the kernels: it would be slow, and they have hardly a branch.
KERNEL_CFLAGS = $(filter-out -fsanitize=fuzzer-no-link,$(ALL_CFLAGS))
ALL_LDFLAGS = -pthread $(LDFLAGS) $(SANITIZE)

PKG_CONFIG ?= pkg-config
UV_CFLAGS = $(shell $(PKG_CONFIG) --cflags libuv)
UV_LIBS = $(shell $(PKG_CONFIG) --libs libuv)
# TLS=no builds without OpenSSL.
TLS ?= yes
ifeq ($(TLS),yes)
TLS_CFLAGS = $(shell $(PKG_CONFIG) --cflags openssl)
TLS_LIBS = $(shell $(PKG_CONFIG) --libs openssl)
else
CPPFLAGS += -DDIPOLED_WITHOUT_TLS
endif
PNG_CFLAGS = $(shell $(PKG_CONFIG) --cflags libpng)
PNG_LIBS = $(shell $(PKG_CONFIG) --libs libpng)
HTTP_CFLAGS = $(shell $(PKG_CONFIG) --cflags libmicrohttpd)
HTTP_LIBS = $(shell $(PKG_CONFIG) --libs libmicrohttpd)
MODBUS_CFLAGS = $(shell $(PKG_CONFIG) --cflags libmodbus)
MODBUS_LIBS = $(shell $(PKG_CONFIG) --libs libmodbus)
JSON_LIBS = $(shell $(PKG_CONFIG) --libs jansson)
# What core's preparation uses. The archives' members are taken as needed, so that the client library
# does without.
# CMINPACK=no builds without the model `gaussians`.
CMINPACK ?= yes
ifeq ($(CMINPACK),yes)
CORE_LIBS = $(shell $(PKG_CONFIG) --libs cminpack)
$(BUILD)/obj/core/models/gaussian_fit.o: EXTRA_CPPFLAGS = $(shell $(PKG_CONFIG) --cflags cminpack)
else
CPPFLAGS += -DCORE_WITHOUT_CMINPACK
endif

# ---- what is built -------------------------------------------------------------------------------

OBJ := $(BUILD)/obj
objects = $(patsubst %.c,$(OBJ)/%.o,$(1))

# The kernels: each file of core/models once for each instruction set and precision.
# The machine that the compiler builds for, which with a cross-compiler is not this one.
ARCH := $(firstword $(subst -, ,$(shell $(CC) -dumpmachine)))
ISAS := portable
ifeq ($(ARCH),x86_64)
ISAS += sse2 avx2 avx512
else ifeq ($(ARCH),aarch64)
ISAS += neon
endif
ifeq ($(ISAS),portable)
ALL_CPPFLAGS += -DCORE_PORTABLE_ALONE
endif
ISA_FLAGS_portable := -O2 -fno-tree-vectorize
ISA_FLAGS_sse2 := -O3 -msse2
ISA_FLAGS_avx2 := -O3 -mavx2 -mfma
ISA_FLAGS_neon := -O3
ISA_FLAGS_avx512 := -O3 -mavx512f -mavx512dq -mavx512vl -mfma -mprefer-vector-width=512
# Files of core/models that hold kernels; the others prepare for the kernels of one that does.
MODELS := $(patsubst core/models/%.c,%,$(shell grep -l CORE_KERNEL_TABLE core/models/*.c))
KERNELS := $(foreach isa,$(ISAS),$(foreach real,32 64,$(MODELS:%=$(OBJ)/core/models/%.$(isa).f$(real).o)))

# Other inner loops that are compiled once for each instruction set.
LOOPS := core/fit/loops core/gather/loops core/montecarlo/walk core/solver/dense_product
KERNELS += $(foreach isa,$(ISAS),$(LOOPS:%=$(OBJ)/%.$(isa).o))

CORE := $(call objects,$(filter-out $(LOOPS:%=%.c),$(wildcard core/*.c core/models/*.c core/montecarlo/*.c core/transport/*.c core/solver/*.c core/lut/*.c core/cells/*.c core/fit/*.c core/gather/*.c core/varying/*.c))) $(KERNELS)
PROTO := $(call objects,$(wildcard proto/*.c))
SERVER := $(call objects,$(wildcard server/*.c server/*/*.c))
LIBRARY := $(call objects,$(wildcard clients/c/*.c))
CLI := $(call objects,$(wildcard clients/cli/*.c))
BENCH := $(call objects,$(wildcard tests/bench/*.c tests/bench/*/*.c))
# The tools of core share these; the command line draws and shows progress with the same two.
TOOLS := $(call objects,core/tools/tools.c clients/cli/progress.c)
TRADEOFF := $(call objects,$(wildcard core/tools/tradeoff/*.c)) $(TOOLS)
# An independent check of the solver and of the table, whose part for g = 0 comes from it.
ISOTROPIC := $(call objects,$(wildcard tests/accuracy/isotropic/*.c))
TABLES := $(call objects,$(wildcard core/tools/transport_table/*.c)) $(ISOTROPIC) $(TOOLS)
REFERENCE := $(call objects,$(wildcard core/tools/reference/*.c)) $(TOOLS)
APERTURES := $(call objects,core/tools/apertures/main.c) $(TOOLS)
PHASES := $(call objects,$(wildcard core/tools/phases/*.c) core/tools/reference/walks.c) $(TOOLS)
SOAK := $(call objects,$(wildcard tests/soak/*.c))
PIPELINE := $(call objects,$(wildcard tests/pipeline/*.c))
# The longest ones come first, so that no processor waits for them at the end.
TESTS := $(addprefix $(BUILD)/tests/,unit/test_kernels accuracy/test_choose accuracy/test_dipole)
TESTS += $(filter-out $(TESTS),$(patsubst tests/%.c,$(BUILD)/tests/%,$(wildcard tests/accuracy/test_*.c tests/unit/test_*.c)))
TEST_SUPPORT := $(call objects,$(filter-out $(wildcard tests/*/test_*.c) $(wildcard tests/accuracy/rings.c tests/accuracy/truth.c tests/bench/*.c tests/bits/*.c tests/e2e/*.c tests/fuzz/*.c tests/pipeline/*.c tests/soak/*.c),$(wildcard tests/*/*.c))) $(ISOTROPIC)

INSTALLED := $(BUILD)/dipoled $(BUILD)/dipole
PROGRAMS := $(INSTALLED) $(BUILD)/bench
LIBRARIES := $(BUILD)/libdipole.a $(BUILD)/libdipole.so

.PHONY: all setup demo check check-long check-structure check-types check-unit check-units-long check-bits check-bits-aarch64 check-e2e check-again check-packages check-soak check-soak-long check-tls-long check-balancer-long check-plan plan scaling check-pipeline check-asan check-tsan check-fuzz check-fuzz-long check-truth check-truth-long check-fits check-varying check-rings rings soak truth fuzz fuzz-merge bench docs gamma-errors tables reference tradeoff apertures figures picture gather-figure fit-bias clean
.DELETE_ON_ERROR:
.SECONDARY:

all: $(PROGRAMS) $(LIBRARIES)

$(OBJ)/%.o: %.c Makefile
	@mkdir -p $(@D)
	$(call SAY,CC,$<)
	$(Q)$(CC) $(ALL_CPPFLAGS) $(EXTRA_CPPFLAGS) $(ALL_CFLAGS) -c -o $@ $<

# Whose loop over listed radii is to be vectorized, and as fast wherever the linker puts it.
$(OBJ)/core/radii.o: override CFLAGS := $(CFLAGS) -O3 -fopenmp-simd -falign-loops=64 -falign-functions=64

# The sums of the table of solutions.
$(OBJ)/core/transport/table.o: override CFLAGS := $(CFLAGS) -O3

# The hash of large sets of points, at the speed of libraries.
$(OBJ)/proto/digest.o: override CFLAGS := $(CFLAGS) -O3 -funroll-loops

# What writes and reads the numbers of JSON and CSV.
$(addprefix $(OBJ)/,core/evaluate.o proto/decimal.o $(addprefix server/http/,answer.o connection.o question.o text.o values.o)): override CFLAGS := $(CFLAGS) -O3

# Loops over blocks of a constant length stay loops: written out they are no faster, and several times
# as long. But the series of transport are written out, so that their factors are constants.
SHORT_LOOPS = $(if $(findstring clang,$(CC)),,--param max-completely-peeled-insns=60)
$(OBJ)/core/models/transport.%: SHORT_LOOPS =

# core/models/NAME.ISA.fREAL.o
define kernel_rule
$(OBJ)/core/models/%.$(1).f$(2).o: core/models/%.c Makefile
	@mkdir -p $$(@D)
	$$(call SAY,CC,$$< $(1) f$(2))
	$$(Q)$$(CC) $$(ALL_CPPFLAGS) -DCORE_ISA=$(1) -DCORE_REAL=$(2) $$(KERNEL_CFLAGS) $$(ISA_FLAGS_$(1)) $$(SHORT_LOOPS) -c -o $$@ $$<
endef
$(foreach isa,$(ISAS),$(foreach real,32 64,$(eval $(call kernel_rule,$(isa),$(real)))))

# Tables' lookups gather: 16 at a time take longer than twice 8.
$(addprefix $(OBJ)/core/models/,surface.avx512.f32.o varying.avx512.f32.o): ISA_FLAGS_avx512 += -mprefer-vector-width=256

# NAME.ISA.o
define loop_rule
$(OBJ)/%.$(1).o: %.c Makefile
	@mkdir -p $$(@D)
	$$(call SAY,CC,$$< $(1))
	$$(Q)$$(CC) $$(ALL_CPPFLAGS) -DCORE_ISA=$(1) $$(KERNEL_CFLAGS) $$(ISA_FLAGS_$(1)) -c -o $$@ $$<
endef
$(foreach isa,$(ISAS),$(eval $(call loop_rule,$(isa))))

$(SERVER) $(OBJ)/tests/e2e/count_allocations.o: EXTRA_CPPFLAGS = $(UV_CFLAGS) $(TLS_CFLAGS) $(HTTP_CFLAGS) $(MODBUS_CFLAGS)

# Taken up by the assembler.
$(OBJ)/core/transport/table_data.o: core/transport/transport.table
$(OBJ)/core/fit/aperture.o: core/fit/aperture.table

# The page of --http likewise. A Content-Security-Policy names its script and its style by the sums of
# what stands between the tags, in base64.
sum_of_tag = $(shell env printf "$$({ echo; sed -n '/^<$(1)>$$/,/^<\/$(1)>$$/{//!p}' server/http/page.html; } | sha256sum | cut -c 1-64 | sed 's/../\\x&/g')" | base64)
$(OBJ)/server/http/page.o: server/http/page.html
$(OBJ)/server/http/page.o: EXTRA_CPPFLAGS += -DPAGE_SCRIPT_SHA256='"$(call sum_of_tag,script)"' -DPAGE_STYLE_SHA256='"$(call sum_of_tag,style)"'

$(BUILD)/libcore.a: $(CORE)
$(BUILD)/libproto.a: $(PROTO)
$(BUILD)/libcore.a $(BUILD)/libproto.a:
	$(call SAY,AR,$@)
	@rm -f $@
	$(Q)$(AR) qcs $@ $^

# The client library holds the codec and the core, so that it needs nothing else.
$(BUILD)/libdipole.a: $(LIBRARY) $(PROTO) $(CORE)
	$(call SAY,AR,$@)
	@rm -f $@
	$(Q)$(AR) qcs $@ $^

$(BUILD)/libdipole.so.$(VERSION): $(LIBRARY) $(BUILD)/libproto.a $(BUILD)/libcore.a clients/c/libdipole.map
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -shared -Wl,-soname,libdipole.so.$(SOVERSION) -Wl,--version-script=clients/c/libdipole.map -Wl,--no-undefined -o $@ $(filter %.o %.a,$^) $(TLS_LIBS) -lm

$(BUILD)/libdipole.so: $(BUILD)/libdipole.so.$(VERSION)
	$(Q)ln -sf libdipole.so.$(VERSION) $(BUILD)/libdipole.so.$(SOVERSION)
	$(Q)ln -sf libdipole.so.$(SOVERSION) $@

$(BUILD)/dipoled: $(SERVER) $(BUILD)/libproto.a $(BUILD)/libcore.a
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ $(UV_LIBS) $(TLS_LIBS) $(MODBUS_LIBS) $(HTTP_LIBS) $(JSON_LIBS) $(CORE_LIBS) -lm

# The same, and a test can see how often it takes memory from the heap.
$(BUILD)/dipoled-counting: $(SERVER) $(OBJ)/tests/e2e/count_allocations.o $(BUILD)/libproto.a $(BUILD)/libcore.a
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -Wl,--wrap=malloc,--wrap=calloc,--wrap=realloc -o $@ $^ $(UV_LIBS) $(TLS_LIBS) $(MODBUS_LIBS) $(HTTP_LIBS) $(JSON_LIBS) $(CORE_LIBS) -lm

$(OBJ)/clients/c/tls.o $(OBJ)/tests/bench/bench_tls.o: EXTRA_CPPFLAGS = $(TLS_CFLAGS)
$(OBJ)/clients/cli/image.o: EXTRA_CPPFLAGS = $(PNG_CFLAGS)
$(BUILD)/dipole: $(CLI) $(BUILD)/libdipole.a
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ $(PNG_LIBS) $(TLS_LIBS) $(CORE_LIBS) -lm

$(BUILD)/bench: $(BENCH) $(BUILD)/libdipole.a
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ $(TLS_LIBS) $(CORE_LIBS) -lm

$(BUILD)/soak-load: $(SOAK) $(BUILD)/libdipole.a
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ $(TLS_LIBS) $(CORE_LIBS) -lm

$(BUILD)/pipeline: $(PIPELINE) $(BUILD)/libdipole.a
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ $(TLS_LIBS) $(CORE_LIBS) -lm

$(BUILD)/wire-tables: $(OBJ)/proto/tools/wire_tables.o $(BUILD)/libproto.a $(BUILD)/libcore.a
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ -lm

$(BUILD)/tests/accuracy/truth: $(call objects,tests/accuracy/truth.c tests/accuracy/forms.c tests/accuracy/reference.c tests/accuracy/reference_fresnel.c) $(ISOTROPIC) $(BUILD)/libcore.a
	@mkdir -p $(@D)
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ -lmpfr -lgmp $(CORE_LIBS) -lm

$(BUILD)/tests/accuracy/rings: $(call objects,tests/accuracy/rings.c core/tools/reference/walks.c) $(TOOLS) $(BUILD)/libcore.a
	@mkdir -p $(@D)
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ $(CORE_LIBS) -lm

$(BUILD)/tests/bits: $(OBJ)/tests/bits/bits.o $(BUILD)/libcore.a
	@mkdir -p $(@D)
	$(CC) $(ALL_LDFLAGS) -o $@ $^ $(CORE_LIBS) -lm

# For clang and its libFuzzer alone: `make fuzz` builds it in a folder of its own.
FUZZ := $(call objects,$(wildcard tests/fuzz/*.c))
FUZZED := $(filter-out $(call objects,server/main.c clients/cli/main.c),$(SERVER) $(CLI))
$(FUZZ): EXTRA_CPPFLAGS = $(UV_CFLAGS) $(MODBUS_CFLAGS)
$(BUILD)/fuzz: $(FUZZ) $(FUZZED) $(BUILD)/libdipole.a
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -fsanitize=fuzzer -o $@ $^ $(UV_LIBS) $(TLS_LIBS) $(MODBUS_LIBS) $(HTTP_LIBS) $(JSON_LIBS) $(PNG_LIBS) $(CORE_LIBS) -lm

$(BUILD)/tests/%: $(OBJ)/tests/%.o $(TEST_SUPPORT) $(BUILD)/libdipole.a
	@mkdir -p $(@D)
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $(filter %.o,$^) $(filter %.a,$^) -lcmocka -lmpfr -lgmp $(TLS_LIBS) $(CORE_LIBS) $(TEST_LIBS) -lm

# The daemon's cache, tested without a daemon.
CACHE_TESTS := test_cache test_profiles
$(CACHE_TESTS:%=$(BUILD)/tests/unit/%): $(call objects,server/store/cache.c server/store/points.c server/store/profiles.c server/observe/stats.c)
$(CACHE_TESTS:%=$(BUILD)/tests/unit/%): TEST_LIBS = $(UV_LIBS)
$(CACHE_TESTS:%=$(OBJ)/tests/unit/%.o): EXTRA_CPPFLAGS = $(UV_CFLAGS)

# Its input and histograms likewise.
$(BUILD)/tests/unit/test_histogram: $(call objects,server/observe/latency.c)
$(BUILD)/tests/unit/test_histogram: TEST_LIBS = $(UV_LIBS)
$(BUILD)/tests/unit/test_input: $(call objects,server/net/buffers.c)
$(BUILD)/tests/unit/test_input: TEST_LIBS = $(UV_LIBS)
$(OBJ)/tests/unit/test_input.o: EXTRA_CPPFLAGS = $(UV_CFLAGS)

# A worker with clients of the test's own.
$(BUILD)/tests/unit/test_worker: $(filter-out $(call objects,server/main.c),$(SERVER))
$(BUILD)/tests/unit/test_worker: TEST_LIBS = $(UV_LIBS) $(MODBUS_LIBS) $(HTTP_LIBS) $(JSON_LIBS)
$(OBJ)/tests/unit/test_worker.o: EXTRA_CPPFLAGS = $(UV_CFLAGS)

# And what Modbus is made of.
$(BUILD)/tests/unit/test_modbus: $(call objects,server/net/access.c $(addprefix server/modbus/,codec.c diagnostics.c receiver.c))
$(OBJ)/tests/unit/test_modbus.o: EXTRA_CPPFLAGS = $(MODBUS_CFLAGS)

-include $(shell find $(OBJ) -name '*.d' 2>/dev/null)

# ---- what is run ---------------------------------------------------------------------------------

# Packages come first and in a make of their own: pkg-config's answers are asked for after it.
setup:
	@sh .ci/install-packages

demo:
	@sh .ci/install-packages demo
	@$(MAKE) --no-print-directory -j2 all
	@sh clients/demo.sh $(BUILD)

# Debian's prometheus and promtool, taken out of the package: installing that would start a server.
# The tests that need them say so if they are not to be had.
$(BUILD)/prometheus:
	@mkdir -p $(@D)/prometheus.d
	-@if command -v prometheus >/dev/null; then ln -sf "$$(command -v prometheus)" "$$(command -v promtool)" $(@D); \
	  elif command -v apt-get >/dev/null; then cd $(@D)/prometheus.d && apt-get -qq -o APT::Sandbox::User=root download prometheus && \
	  dpkg-deb --fsys-tarfile prometheus_*.deb | tar -x ./usr/bin && mv -f usr/bin/promtool usr/bin/prometheus ..; fi
	@rm -rf $(@D)/prometheus.d

check:
	@sh .ci/install-packages
	@$(MAKE) --no-print-directory $(BUILD)/prometheus
	@$(MAKE) --no-print-directory -j2 all $(TESTS) $(BUILD)/tests/bits $(BUILD)/tests/accuracy/truth $(BUILD)/dipoled-counting $(BUILD)/wire-tables $(BUILD)/trade-speed $(BUILD)/soak-load $(BUILD)/pipeline
	+@bash tests/run-check.sh $(BUILD)/logs structure+types bits e2e+soak,fuzz,truth,unit

# What takes minutes by itself. .ci/run runs it as well.
check-long:
	@sh .ci/install-packages demo check deb ci
	@$(MAKE) --no-print-directory -j2 all $(BUILD)/tests/bits $(BUILD)/soak-load $(BUILD)/pipeline
	+@bash tests/run-check.sh $(BUILD)/logs-long bits-aarch64 soak-long tls-long balancer-long+rings,truth-long plan pipeline fits+varying units-long fuzz-long packages deb

# Fails when modules include each other in a circle.
check-structure:
	@$(PYTHON) tests/structure.py

# Checks the types of the Python module and of the examples in Python.
check-types:
	@MYPYPATH=clients/python:clients/modbus $(PYTHON) -m mypy --strict --enable-incomplete-feature=Unpack --cache-dir $(BUILD)/mypy clients/python/dipole clients/python/examples clients/modbus

# Each test program by itself, so that one that crashes takes no other with it.
check-unit: $(TESTS)
	@UNIT_LIMIT_S=$(UNIT_LIMIT_S) bash tests/run-units.sh $(BUILD)/logs $(TESTS)

# Those that have a long form.
LONG_TESTS := $(addprefix $(BUILD)/tests/,unit/test_kernels accuracy/test_derivative accuracy/test_lut accuracy/test_transport_g accuracy/test_transport_table)
check-units-long: $(LONG_TESTS)
	@UNIT_LONG=yes bash tests/run-units.sh $(BUILD)/logs-long $(LONG_TESTS)

check-bits: $(BUILD)/tests/bits
	@sh tests/run-bits.sh $(BUILD) native

check-bits-aarch64: $(BUILD)/tests/bits
	@sh tests/run-bits.sh $(BUILD) aarch64

PYTEST = env TESTED_BUILD=$(abspath $(BUILD)) PYTHONPATH=clients/python:tests/e2e PYTHONDONTWRITEBYTECODE=1 $(PYTHON) -m pytest -q -rfEs -p no:cacheprovider

check-e2e: all $(BUILD)/dipoled-counting $(BUILD)/soak-load $(BUILD)/pipeline
	$(PYTEST) -n 2 --dist loadfile --durations=20 --ignore=tests/e2e/test_packages.py tests/e2e

# Runs the one test of tests/e2e that the variable TEST of the environment names.
check-again:
	@$(PYTEST) "$$TEST"

# Builds the Debian packages twice.
check-packages: all
	$(PYTEST) tests/e2e/test_packages.py

check-soak: all $(BUILD)/soak-load
	SOAK_S=15 $(PYTEST) -s tests/soak

check-soak-long: all $(BUILD)/soak-load
	SOAK_S=120 $(PYTEST) -s tests/soak

# Ten thousand handshakes that somebody leaves half open, five thousand with faults, and a million
# records with faults.
check-tls-long: all
	TLS_HANDSHAKES=10000 TLS_RECORDS=1000000 $(PYTEST) --durations=5 tests/e2e/test_tls.py

# Clients of all kinds behind HAProxy, while three daemons are killed and drained.
BALANCER_S ?= 600
check-balancer-long: all $(BUILD)/soak-load
	BALANCER_S=$(BALANCER_S) $(PYTEST) -k all_kinds tests/e2e/test_balancer.py

# How many daemons a farm needs; PLAN='--nodes 2e3 --rate 50' for another one. `make scaling` puts the
# tables into server/DEPLOYING.md. check-plan compares the simulation with three daemons.
PLAN_COMMAND = env TESTED_BUILD=$(abspath $(BUILD)) PYTHONPATH=clients/python PYTHONDONTWRITEBYTECODE=1 $(PYTHON) tests/plan.py
plan: all
	@$(PLAN_COMMAND) $(PLAN)

scaling: all
	@$(PLAN_COMMAND) $(PLAN) --write server/DEPLOYING.md

check-plan: all
	@$(PLAN_COMMAND) --check

# Eight threads, each with 256 requests under way, and each answer compared.
PIPELINE_REQUESTS ?= 10000000
check-pipeline:
	@sh .ci/install-packages
	@$(MAKE) --no-print-directory -j2 all $(BUILD)/pipeline
	PIPELINE_REQUESTS=$(PIPELINE_REQUESTS) $(PYTEST) -s tests/e2e/test_pipeline.py

# Full load for ten minutes.
SOAK_S ?= 600
soak:
	@sh .ci/install-packages
	@$(MAKE) --no-print-directory -j2 all $(BUILD)/soak-load
	SOAK_S=$(SOAK_S) $(PYTEST) -s tests/soak

check-asan:
	@sh .ci/install-packages
	@$(MAKE) --no-print-directory build/libdipole.so
	@$(MAKE) --no-print-directory BUILD=build-asan SANITIZE='-fsanitize=address,undefined -fno-sanitize-recover=all' CFLAGS='-O1 -g' UNIT_LIMIT_S=3600 check

check-tsan:
	@sh .ci/install-packages
	@$(MAKE) --no-print-directory build/libdipole.so
	@$(MAKE) --no-print-directory BUILD=build-tsan SANITIZE='-fsanitize=thread' CFLAGS='-O1 -g' UNIT_LIMIT_S=3600 check

# Coverage-guided fuzzing by clang's libFuzzer, with sanitizers, in a folder of its own. What `fuzz`
# has found, `fuzz-merge` puts into tests/fuzz/corpus as far as it reaches new code.
# With sanitizers, clang cannot vectorize each loop that is marked for it.
BUILT_FUZZ = build-fuzz
BUILD_FUZZ = $(MAKE) --no-print-directory -j2 BUILD=$(BUILT_FUZZ) CC=clang CFLAGS='-O1 -g -Wno-pass-failed' SANITIZE='-fsanitize=fuzzer-no-link -fsanitize=address,undefined -fno-sanitize-recover=all' $(BUILT_FUZZ)/fuzz
# The corpus, and so many seconds of other inputs for each target, at most. The short form builds
# portable kernels alone, which takes half the time.
check-fuzz: FUZZ_S = 4
check-fuzz: BUILT_FUZZ = build-fuzz-portable
check-fuzz: BUILD_FUZZ += ISAS=portable
check-fuzz-long: FUZZ_S = 5
check-fuzz check-fuzz-long:
	@if ! command -v clang >/dev/null; then echo "fuzz: everything was skipped: there is no clang"; exit 0; fi; \
	  $(BUILD_FUZZ) && $(PYTHON) tests/fuzz/fuzz.py $(BUILT_FUZZ)/fuzz check $(FUZZ_S)

fuzz:
	@sh .ci/install-packages
	@$(BUILD_FUZZ)
	@$(PYTHON) tests/fuzz/fuzz.py build-fuzz/fuzz $(or $(SECONDS),300)

fuzz-merge:
	@$(BUILD_FUZZ)
	@$(PYTHON) tests/fuzz/fuzz.py build-fuzz/fuzz merge

# Random values of all models against their formulas in more digits, and the error that each states.
SECONDS ?=
SEED ?=
# A fixed seed. The long form has as many rounds as each class needs.
check-truth: ROUNDS = 14
check-truth-long: ROUNDS = 20
check-truth check-truth-long: $(BUILD)/tests/accuracy/truth
	@$(BUILD)/tests/accuracy/truth --rounds $(ROUNDS) --seed 1

truth: $(BUILD)/tests/accuracy/truth
	$(BUILD)/tests/accuracy/truth --seconds $(or $(SECONDS),60) $(SEED:%=--seed %)

# Media that vary: 100,000 random media and radii for each model, surfaces with tolerance 1e-5 for a
# grid of 192 pairs of g and eta, and 40 media that are solved: some five minutes. Each further
# solved medium takes two seconds.
check-varying: VARYING_SOLVED = 40
check-varying: $(BUILD)/tests/accuracy/test_varying
	VARYING_MEDIA=100000 VARYING_SURFACES=192 VARYING_SOLVED=$(VARYING_SOLVED) $(BUILD)/tests/accuracy/test_varying

# Coefficients from 10,000 random sets of readings for each model and scale.
check-fits: $(BUILD)/tests/accuracy/test_fit
	FIT_SETS=10000 $(BUILD)/tests/accuracy/test_fit

# Monte Carlo against the solver, ring by ring, MILLIONS of photons for each g.
check-rings: MILLIONS = 4
check-rings rings: $(BUILD)/tests/accuracy/rings
	$(BUILD)/tests/accuracy/rings $(MILLIONS)

MILLIONS ?= 100

bench: $(BUILD)/bench
	$(BUILD)/bench

$(BUILD)/trade-speed: $(TRADEOFF) $(BUILD)/libcore.a
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ $(CORE_LIBS) -lm

# On a machine that does little else: it times what is chosen by cost.
tradeoff:
	@sh .ci/install-packages demo figures
	@$(MAKE) --no-print-directory -j2 $(BUILD)/trade-speed
	$(BUILD)/trade-speed $(BUILD)/tradeoff
	$(PYTHON) core/tools/tradeoff/draw.py $(BUILD)/tradeoff
	cp $(BUILD)/tradeoff/costs.def core/
	cp $(BUILD)/tradeoff/front.svg core/tools/tradeoff/

$(BUILD)/transport-table: $(TABLES) $(BUILD)/libcore.a
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ -lm

# Some 100 minutes on two cores; after an interruption it goes on where it was.
tables: $(BUILD)/transport-table
	$(BUILD)/transport-table $(BUILD)/tables core/transport/transport.table

$(BUILD)/apertures: $(APERTURES) $(BUILD)/libcore.a
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ -lm

# Minutes on two cores; after an interruption it goes on where it was. Then the program is made anew, and
# its table compared with other media. GRIDS=normal takes three times as long.
GRIDS ?= quick
apertures: $(BUILD)/apertures
	$(BUILD)/apertures $(BUILD)/apertures-parts core/fit/aperture.table $(GRIDS)
	@$(MAKE) --no-print-directory $(BUILD)/apertures
	$(BUILD)/apertures $(BUILD)/apertures-parts core/fit/aperture_errors.def

$(BUILD)/reference: $(REFERENCE) $(BUILD)/libcore.a
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ $(CORE_LIBS) -lm

# Up to an hour, on all cores; after an interruption it goes on where it was. EFFORT=normal: minutes.
EFFORT ?= finest
reference: $(BUILD)/reference
	$(BUILD)/reference $(BUILD)/reference-parts core/transport/reference.csv $(EFFORT)

$(BUILD)/phases: $(PHASES) $(BUILD)/libcore.a
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ $(CORE_LIBS) -lm

# Minutes, on all cores; after an interruption it goes on where it was.
gamma-errors: $(BUILD)/phases
	$(BUILD)/phases $(BUILD)/phases-parts core/gamma_errors.def

figures:
	@sh .ci/install-packages demo figures
	@$(MAKE) --no-print-directory -j2 $(BUILD)/dipoled $(BUILD)/dipole
	DIPOLED=private:$(BUILD)/dipoled $(PYTHON) core/tools/figures.py --output $(BUILD)/figures $(FIGURES_OPTIONS)
	cp $(BUILD)/figures/tissue.svg core/tools/
	$(BUILD)/dipole plot --medium skin1 --model classical,better,transport --error --plot clients/cli/skin1.svg

# A mesh in marble, milk and skin by three models, with light gathered from points.
$(OBJ)/clients/c/examples/picture.o: EXTRA_CPPFLAGS = $(PNG_CFLAGS)
$(BUILD)/picture: $(OBJ)/clients/c/examples/picture.o $(BUILD)/libdipole.a
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $^ $(PNG_LIBS) $(TLS_LIBS) -lm

picture:
	@sh .ci/install-packages demo
	@$(MAKE) --no-print-directory -j2 $(BUILD)/dipoled $(BUILD)/picture
	DIPOLED=private:$(BUILD)/dipoled $(BUILD)/picture clients/c/examples/picture.png

# Light gathered from points: error against time, time against points, and sheets of light. It takes
# some three minutes.
gather-figure: $(BUILD)/bench $(BUILD)/tests/accuracy/test_gather
	@sh .ci/install-packages figures
	@mkdir -p $(BUILD)/figures
	$(BUILD)/bench --long gather > $(BUILD)/figures/gather.tsv
	$(BUILD)/tests/accuracy/test_gather > $(BUILD)/figures/gather.txt
	$(PYTHON) core/tools/gather.py $(BUILD)/figures/gather.tsv $(BUILD)/figures/gather.txt core/tools/gather.svg

# What diffusion models make of readings, beside transport: a table and build/figures/fit_bias.svg.
fit-bias:
	@sh .ci/install-packages demo figures
	@$(MAKE) --no-print-directory -j2 $(BUILD)/dipoled
	DIPOLED=private:$(BUILD)/dipoled $(PYTHON) core/tools/fit_bias.py --output $(BUILD)/figures

docs: $(BUILD)/wire-tables
	@sh .ci/install-packages docs
	$(BUILD)/wire-tables proto/PROTOCOL.md proto/REGISTERS.md
	@$(MAKE) --no-print-directory -j2 manuals

include clients/packaging/packaging.mk

clean:
	rm -rf $(BUILD) build-asan build-tsan build-fuzz build-fuzz-portable
