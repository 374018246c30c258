# Where things go, and what is made only to be installed. Part of the Makefile.

BINDIR ?= $(PREFIX)/bin
LIBDIR ?= $(PREFIX)/lib
INCLUDEDIR ?= $(PREFIX)/include
MANDIR ?= $(PREFIX)/share/man
DOCDIR ?= $(PREFIX)/share/doc
UNITDIR ?= $(PREFIX)/lib/systemd/system
BASHDIR ?= $(PREFIX)/share/bash-completion/completions
ZSHDIR ?= $(PREFIX)/share/zsh/site-functions
# Where $(PYTHON) looks for modules below PREFIX.
PYTHONDIR ?= $(shell $(PYTHON) clients/packaging/python_folder.py $(PREFIX))

PACKAGING := clients/packaging
PACKAGING_SOURCES := $(wildcard $(PACKAGING)/*.py $(PACKAGING)/debian/* proto/*.md)
RUN_PYTHON := PYTHONDONTWRITEBYTECODE=1 $(PYTHON)

# What install.sh fills in.
INSTALL = BUILD='$(BUILD)' DESTDIR='$(DESTDIR)' VERSION=$(VERSION) SOVERSION=$(SOVERSION) \
	PREFIX=$(PREFIX) BINDIR=$(BINDIR) LIBDIR=$(LIBDIR) INCLUDEDIR=$(INCLUDEDIR) MANDIR=$(MANDIR) \
	DOCDIR=$(DOCDIR) \
	UNITDIR=$(UNITDIR) BASHDIR=$(BASHDIR) ZSHDIR=$(ZSHDIR) PYTHONDIR=$(PYTHONDIR) \
	sh $(PACKAGING)/install.sh

.PHONY: manuals completions install uninstall deb packages check-deb

# The pages and completions are made from what the programs say, hence after them; by Python, which
# building the programs does without.
$(BUILD)/manuals/made: $(BUILD)/dipoled $(BUILD)/dipole clients/c/dipole.h $(PACKAGING_SOURCES)
	$(call SAY,MAN,$(@D))
	$(Q)$(RUN_PYTHON) $(PACKAGING)/manuals.py $(BUILD) $(VERSION)
	@touch $@

$(BUILD)/completions/made: $(BUILD)/dipoled $(BUILD)/dipole $(PACKAGING_SOURCES)
	$(call SAY,TAB,$(@D))
	$(Q)$(RUN_PYTHON) $(PACKAGING)/completions.py $(BUILD)
	@touch $@

manuals: $(BUILD)/manuals/made
completions: $(BUILD)/completions/made

install: all manuals completions
	$(Q)$(INSTALL) install
	$(Q)[ -n "$(DESTDIR)" ] || [ "$$(id -u)" != 0 ] || ldconfig

# With the same PREFIX, DESTDIR and the like.
uninstall:
	$(Q)$(INSTALL) uninstall

# Built as Debian builds its packages, apart from what is built otherwise. Flags go through the
# environment, so that the Makefile can add to them.
BUILDFLAGS := DEB_BUILD_MAINT_OPTIONS=hardening=+bindnow dpkg-buildflags --get
deb:
	@sh .ci/install-packages deb
	@CFLAGS="$$($(BUILDFLAGS) CFLAGS)" CPPFLAGS="$$($(BUILDFLAGS) CPPFLAGS)" \
		LDFLAGS="$$($(BUILDFLAGS) LDFLAGS)" $(MAKE) --no-print-directory -j2 BUILD=$(BUILD)/debian \
		PACKAGES=$(BUILD)/deb packages

# In a new system: installs them, asks the daemon, and takes them away again.
check-deb: deb
	@sh tests/packages/run.sh $(BUILD)/deb

# Of what is in $(BUILD), however that was built.
PACKAGES ?= $(BUILD)/deb
packages: $(BUILD)/dipoled $(BUILD)/dipole $(LIBRARIES) manuals completions
	$(Q)$(RUN_PYTHON) $(PACKAGING)/packages.py $(BUILD) $(VERSION) $(SOVERSION) $(PACKAGES)
