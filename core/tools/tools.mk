# Programs that make tables and figures. Part of the Makefile. Those that take minutes and more go on
# where they were after an interruption.

# These share; the command line shows progress with the same.
TOOLS := $(call objects,core/tools/tools.c clients/cli/progress.c)
# An independent check of the solver and of the table, whose part for g = 0 comes from it.
ISOTROPIC := $(call objects,$(wildcard tests/accuracy/isotropic/*.c))
$(ISOTROPIC): override CFLAGS := $(CFLAGS) -O3
tool = $(call objects,$(wildcard core/tools/$(1)/*.c)) $(TOOLS) $(BUILD)/libcore.a
$(BUILD)/transport-table: $(call tool,transport_table) $(ISOTROPIC)
$(BUILD)/apertures: $(call tool,apertures)
PROGRAMS += $(addprefix $(BUILD)/,transport-table apertures)

.PHONY: tables reference tradeoff apertures figures picture gather-figure colour-errors colour-furnace limit

# On a machine that does little else: it times what is chosen by cost.
tradeoff: ## speed against accuracy, in build/tradeoff, and core/costs.def (minutes)
	@sh .ci/install-packages demo figures
	@$(MAKE) --no-print-directory -j2 $(BUILD)/bench $(BUILD)/dipoled
	@mkdir -p $(BUILD)/tradeoff
	$(BUILD)/bench kernel lut > $(BUILD)/tradeoff/bench.tsv
	DIPOLED=private:$(BUILD)/dipoled $(PYTHON) core/tools/tradeoff.py $(BUILD)/tradeoff/bench.tsv $(BUILD)/tradeoff
	cp $(BUILD)/tradeoff/costs.def core/
	cp $(BUILD)/tradeoff/front.svg core/tools/

limit: ## kernels beside their least cycles by llvm-mca: core/LIMITS.md
	@sh .ci/install-packages bench
	@$(MAKE) --no-print-directory -j2 $(BUILD)/bench
	$(BUILD)/bench limit > $(BUILD)/limit.tsv
	$(PYTHON) core/tools/limit.py $(BUILD)/limit.tsv core/LIMITS.md

tables: $(BUILD)/transport-table ## core/transport/transport.table, solved anew (2 hours)
	$(BUILD)/transport-table $(BUILD)/tables core/transport/transport.table

# The program is made anew, and its table compared with other media.
apertures: $(BUILD)/apertures ## core/fit/aperture.table and its errors, solved anew (minutes)
	$(BUILD)/apertures $(BUILD)/apertures-parts core/fit/aperture.table
	@$(MAKE) --no-print-directory $(BUILD)/apertures
	$(BUILD)/apertures compare $(BUILD)/apertures-parts core/fit/aperture_errors.def

reference: $(BUILD)/dipoled ## core/transport/reference.csv, R(r) for many g, solved anew (an hour)
	DIPOLED=private:$(BUILD)/dipoled $(PYTHON) core/tools/reference.py core/transport/reference.csv

figures: ## pictures of tissue and layers, and which model is nearer to transport, in build/figures (minutes)
	@sh .ci/install-packages demo figures
	@$(MAKE) --no-print-directory -j2 $(BUILD)/dipoled $(BUILD)/dipole
	DIPOLED=private:$(BUILD)/dipoled $(PYTHON) core/tools/figures.py --output $(BUILD)/figures $(FIGURES_OPTIONS)
	cp $(BUILD)/figures/tissue.svg $(BUILD)/figures/layers.svg core/tools/
	$(BUILD)/dipole plot --medium skin1 --model classical,better,transport --error --plot clients/cli/skin1.svg

picture: ## a rabbit in marble, milk and skin by three models, clients/python/examples/picture.png (minutes)
	@sh .ci/install-packages demo figures
	@$(MAKE) --no-print-directory -j2 $(BUILD)/dipoled
	DIPOLED=private:$(BUILD)/dipoled PYTHONPATH=clients/python $(PYTHON) clients/python/examples/picture.py clients/python/examples/picture.png

# Error against time, time against points, and sheets of light: some three minutes.
gather-figure: $(BUILD)/bench $(BUILD)/tests/accuracy/test_gather ## build/figures/gather.svg: light gathered from points
	@sh .ci/install-packages figures
	@mkdir -p $(BUILD)/figures
	$(BUILD)/bench --long gather > $(BUILD)/figures/gather.tsv
	$(BUILD)/tests/accuracy/test_gather > $(BUILD)/figures/gather.txt
	$(PYTHON) core/tools/gather.py $(BUILD)/figures/gather.tsv $(BUILD)/figures/gather.txt core/tools/gather.svg

# With FIT=fit also the constants of the closed form, clients/cli/formula.def.
colour-errors: ## formulas from colours to albedos against transport: core/COLOURS.md and a figure (minutes)
	@sh .ci/install-packages figures
	@$(MAKE) --no-print-directory -j2 $(BUILD)/dipoled
	DIPOLED=private:$(BUILD)/dipoled $(PYTHON) core/tools/colours.py $(BUILD)/colour-errors $(FIT)
	cp $(BUILD)/colour-errors/colours.svg core/tools/

colour-furnace: ## a figure of the colours in Debian's Blender (minutes, 500 MB of packages)
	@sh .ci/install-packages figures blender
	@$(MAKE) --no-print-directory -j2 all
	@mkdir -p $(BUILD)/colour-furnace
	TESTED_BUILD=$(abspath $(BUILD)) PYTHONPATH=clients/python:tests/e2e $(PYTHON) tests/blender/test_furnace.py $(BUILD)/colour-furnace/furnace.svg
	cp $(BUILD)/colour-furnace/furnace.svg core/tools/
