# dipoled: `make demo` shows it working, `make check` tests it. Both install what is missing.
# `make help` lists the targets, which are in tests/, core/tools/ and clients/packaging/, too.

PREFIX ?= /usr/local
DESTDIR ?=
BUILD ?= build
PYTHON ?= /usr/bin/python3

VERSION := 0.1.0
SOVERSION := 0

# Short lines; make V=1 shows the commands.
V ?= 0
Q := $(if $(filter 0,$(V)),@)
SAY = $(if $(Q),@echo " " $(1) $(2))

CC := $(if $(filter default,$(origin CC)),cc,$(CC))
CFLAGS ?= -O2 -g
WARNINGS := -Wall -Wextra -Wno-missing-field-initializers -Werror -Wshadow -Wstrict-prototypes -Wmissing-prototypes -Wpointer-arith
# -ffp-contract=off: the same bits from every compiler and machine. The two -fno options change no
# value; without them loops with sqrt and selections are not vectorized. GCC 12.2 at -O2 drops the
# rounding of `x[0] = (double)(float)x[0]; x[1] = (double)(float)x[1];` in its SLP vectorizer.
BITS := -ffp-contract=off -fno-math-errno -fno-trapping-math -fno-tree-slp-vectorize
# The x87 of 32-bit machines rounds twice.
BITS += $(if $(shell $(CC) -dM -E -x c /dev/null | grep -w __i386__),-msse2 -mfpmath=sse)
ALL_CFLAGS = -std=c17 $(WARNINGS) $(BITS) -fPIC -pthread $(CFLAGS) $(SANITIZE)
ALL_CPPFLAGS = -D_GNU_SOURCE -I. -DDIPOLED_VERSION='"$(VERSION)"' -MMD -MP $(CPPFLAGS)
# Packed relocations: a thirtieth of the daemon less. Debian 12's linker has them for x86-64.
ALL_LDFLAGS = -pthread $(if $(filter x86_64,$(ARCH)),-Wl$(comma)-z$(comma)pack-relative-relocs) $(LDFLAGS) $(SANITIZE)
comma := ,

# The flags and libraries of a package, asked for where they are used.
PKG_CONFIG ?= pkg-config
cflags = $(shell $(PKG_CONFIG) --cflags $(1))
libs = $(shell $(PKG_CONFIG) --libs $(1))
TLS_CFLAGS = $(call cflags,openssl)
TLS_LIBS = $(call libs,openssl)
CORE_LIBS = $(call libs,cminpack)
SERVER_LIBS = $(call libs,libuv) $(TLS_LIBS) $(call libs,libmodbus) $(call libs,libmicrohttpd) $(call libs,jansson)

# ---- objects -------------------------------------------------------------------------------------

OBJ := $(BUILD)/obj
objects = $(patsubst %.c,$(OBJ)/%.o,$(1))

# Kernels and other inner loops are compiled once for each instruction set of the machine that the
# compiler builds for, kernels once for each precision, too.
ARCH := $(firstword $(subst -, ,$(shell $(CC) -dumpmachine)))
ISAS := portable $(if $(filter x86_64,$(ARCH)),sse2 avx2 avx512) $(if $(filter aarch64,$(ARCH)),neon)
ALL_CPPFLAGS += $(if $(filter-out portable,$(ISAS)),,-DCORE_PORTABLE_ALONE)
ISA_FLAGS_portable := -O2 -fno-tree-vectorize
ISA_FLAGS_sse2 := -O2 -ftree-vectorize -fvect-cost-model=dynamic -msse2
ISA_FLAGS_avx2 := -O3 -mavx2 -mfma
ISA_FLAGS_neon := -O3
ISA_FLAGS_avx512 := -O3 -mavx512f -mavx512dq -mavx512vl -mfma -mprefer-vector-width=512
# Fuzzing does not follow the kernels: it would be slow, and they have hardly a branch.
KERNEL_CFLAGS = $(filter-out -fsanitize=fuzzer-no-link,$(ALL_CFLAGS))
# Files of core/models that hold kernels; the others prepare for the kernels of one that does.
MODELS := $(patsubst core/models/%.c,%,$(shell grep -l CORE_KERNEL_TABLE core/models/*.c))
LOOPS := core/fit/loops core/gather/loops core/montecarlo/walk core/solver/dense_product
KERNELS := $(foreach isa,$(ISAS),$(foreach real,32 64,$(MODELS:%=$(OBJ)/core/models/%.$(isa).f$(real).o)) $(LOOPS:%=$(OBJ)/%.$(isa).o))

CORE_FOLDERS := core $(addprefix core/,models montecarlo transport solver lut cells fit gather tissue varying)
CORE := $(call objects,$(filter-out $(LOOPS:%=%.c),$(wildcard $(CORE_FOLDERS:%=%/*.c)))) $(KERNELS)
PROTO := $(call objects,$(wildcard proto/*.c))
SERVER := $(call objects,$(wildcard server/*.c server/*/*.c))
LIBRARY := $(call objects,$(wildcard clients/c/*.c))
CLI := $(call objects,$(wildcard clients/cli/*.c))

INSTALLED := $(BUILD)/dipoled $(BUILD)/dipole
LIBRARIES := $(BUILD)/libdipole.a $(BUILD)/libdipole.so
PROGRAMS := $(INSTALLED)

.PHONY: all help setup demo check clean
.DELETE_ON_ERROR:
.SECONDARY:
all: $(INSTALLED) $(LIBRARIES) $(BUILD)/bench ## builds the daemon, the client, the libraries, the benchmark (default)

# $(1): the file and what for, $(2): flags
define compile
@mkdir -p $(@D)
$(call SAY,CC,$(1))
$(Q)$(CC) $(ALL_CPPFLAGS) $(EXTRA_CPPFLAGS) $(2) -c -o $@ $<
endef
$(OBJ)/%.o: %.c Makefile
	$(call compile,$<,$(ALL_CFLAGS))
# Loops over blocks of a constant length stay loops: written out they are no faster, and several times
# as long. But the series of transport are written out, so that their factors are constants. Its
# selections stay apart, too: GCC vectorizes none that it has merged with the one before.
SHORT_LOOPS = $(if $(findstring clang,$(CC)),,--param max-completely-peeled-insns=60)
$(OBJ)/core/models/transport.%: SHORT_LOOPS = $(if $(findstring clang,$(CC)),,-fno-thread-jumps)
define kernel_rule
$(OBJ)/core/models/%.$(1).f$(2).o: core/models/%.c Makefile
	$$(call compile,$$< $(1) f$(2),-DCORE_ISA=$(1) -DCORE_REAL=$(2) $$(KERNEL_CFLAGS) $$(ISA_FLAGS_$(1)) $$(SHORT_LOOPS))
endef
define loop_rule
$(OBJ)/%.$(1).o: %.c Makefile
	$$(call compile,$$< $(1),-DCORE_ISA=$(1) $$(KERNEL_CFLAGS) $$(ISA_FLAGS_$(1)))
endef
$(foreach isa,$(ISAS),$(foreach real,32 64,$(eval $(call kernel_rule,$(isa),$(real))))$(eval $(call loop_rule,$(isa))))

# The loop over listed radii is vectorized, and as fast wherever the linker puts it.
$(OBJ)/core/radii.o: override CFLAGS := $(CFLAGS) -O3 -fopenmp-simd -falign-loops=64 -falign-functions=64
# The hash of large sets of points, at the speed of libraries.
$(OBJ)/proto/digest.o: override CFLAGS := $(CFLAGS) -O3 -funroll-loops
# The sums of the table of solutions and of series, dense systems, and what writes and reads the numbers of JSON and CSV.
$(addprefix $(OBJ)/,core/transport/table.o core/varying/rows.o core/cells/cells.o core/energy.o core/legendre.o core/solver/dense.o core/solver/layer.o core/evaluate.o core/ruler.o proto/decimal.o proto/registers.o proto/schema.o server/modbus/translate.o $(addprefix server/http/,connection.o reply.o request.o text.o)): override CFLAGS := $(CFLAGS) -O3
# Tables' lookups gather: 16 at a time take longer than twice 8.
$(addprefix $(OBJ)/core/models/,surface.avx512.f32.o varying.avx512.f32.o): ISA_FLAGS_avx512 += -mprefer-vector-width=256
$(SERVER): EXTRA_CPPFLAGS = $(call cflags,libuv libmicrohttpd libmodbus) $(TLS_CFLAGS)
# GCC copies and clears structures by `rep movs` and `rep stos`, which take longer to start than libc's
# functions for the few hundred bytes that the structures of a request have.
$(SERVER) $(PROTO): EXTRA_CPPFLAGS += $(if $(filter x86_64,$(ARCH)),$(if $(findstring clang,$(CC)),,-mstringop-strategy=libcall))
$(OBJ)/clients/c/tls.o: EXTRA_CPPFLAGS = $(TLS_CFLAGS)
$(OBJ)/clients/cli/image.o: EXTRA_CPPFLAGS = $(call cflags,libpng lcms2)
$(OBJ)/clients/cli/material.o: EXTRA_CPPFLAGS = $(call cflags,expat jansson)
$(OBJ)/core/models/gaussian_fit.o $(OBJ)/core/fit/layers.o: EXTRA_CPPFLAGS = $(call cflags,cminpack)

# Files that the assembler includes. A Content-Security-Policy names the script and the style of the
# page of --http by the sums of what stands between the tags, in base64.
$(OBJ)/core/transport/table.o: core/transport/transport.table
$(OBJ)/core/fit/aperture.o: core/fit/aperture.table
sum_of_tag = $(shell env printf "$$({ echo; sed -n '/^<$(1)>$$/,/^<\/$(1)>$$/{//!p}' server/http/page.html; } | sha256sum | cut -c 1-64 | sed 's/../\\x&/g')" | base64)
$(OBJ)/server/http/page.o: server/http/page.html
$(OBJ)/server/http/page.o: EXTRA_CPPFLAGS += -DPAGE_SCRIPT_SHA256='"$(call sum_of_tag,script)"' -DPAGE_STYLE_SHA256='"$(call sum_of_tag,style)"'

# The client library holds the codec and the core, so that it needs nothing else.
$(BUILD)/libcore.a: $(CORE)
$(BUILD)/libproto.a: $(PROTO)
$(BUILD)/libdipole.a: $(LIBRARY) $(PROTO) $(CORE)
$(BUILD)/libcore.a $(BUILD)/libproto.a $(BUILD)/libdipole.a:
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
$(BUILD)/dipoled: LIBS = $(SERVER_LIBS) $(CORE_LIBS)
$(BUILD)/dipole: $(CLI) $(BUILD)/libdipole.a
$(BUILD)/dipole: LIBS = $(call libs,libpng lcms2 expat jansson) $(TLS_LIBS) $(CORE_LIBS)

include core/tools/tools.mk tests/tests.mk clients/packaging/packaging.mk

# All programs: of their objects, archives and LIBS.
$(PROGRAMS):
	@mkdir -p $(@D)
	$(call SAY,LD,$@)
	$(Q)$(CC) $(ALL_LDFLAGS) -o $@ $(filter %.o,$^) $(filter %.a,$^) $(LIBS) -lm

-include $(shell find $(OBJ) -name '*.d' 2>/dev/null)

# ---- what a user needs ---------------------------------------------------------------------------

help: ## lists the targets
	@sed -nE 's/^([a-z-]+):[^#]*## (.*)/\1\t\2/p' Makefile tests/tests.mk core/tools/tools.mk clients/packaging/packaging.mk | \
	  while IFS='	' read -r name about; do printf 'make %-20s %s\n' "$$name" "$$about"; done

# Packages come first and in a make of their own: pkg-config's answers are asked for after it.
setup: ## installs the packages of .ci/packages, nothing else
	@sh .ci/install-packages

# Two jobs at once, unless make was told how many.
JOBS = $(if $(filter -j%,$(MAKEFLAGS)),,-j2)

demo: ## measured skin, two models, a table and two pictures
	@sh .ci/install-packages demo
	@$(MAKE) --no-print-directory $(JOBS) all
	@sh clients/demo.sh $(BUILD)

check: ## all tests that take minutes
	@sh .ci/install-packages
	@$(MAKE) --no-print-directory $(JOBS) $(BUILD)/prometheus all check-programs
	+@bash tests/run-check.sh $(BUILD)/logs e2e+structure,types,soak,truth,bits,unit

clean: ## removes what was built
	rm -rf $(BUILD) build-asan build-tsan build-fuzz build-fuzz-portable
