# Installing and packaging. Part of the Makefile.

BINDIR ?= $(PREFIX)/bin
LIBDIR ?= $(PREFIX)/lib
INCLUDEDIR ?= $(PREFIX)/include
MANDIR ?= $(PREFIX)/share/man
DOCDIR ?= $(PREFIX)/share/doc
UNITDIR ?= $(PREFIX)/lib/systemd/system
BASHDIR ?= $(PREFIX)/share/bash-completion/completions
ZSHDIR ?= $(PREFIX)/share/zsh/site-functions
# The folder below PREFIX in which $(PYTHON) looks for modules.
PYTHONDIR ?= $(shell $(PYTHON) clients/packaging/python_folder.py $(PREFIX))

# What install.sh fills in.
INSTALL_FILES = BUILD='$(BUILD)' DESTDIR='$(DESTDIR)' VERSION=$(VERSION) SOVERSION=$(SOVERSION) \
	PREFIX=$(PREFIX) BINDIR=$(BINDIR) LIBDIR=$(LIBDIR) INCLUDEDIR=$(INCLUDEDIR) MANDIR=$(MANDIR) \
	SYSTEM_PREFIXES='$(SYSTEM_PREFIXES)' DOCDIR=$(DOCDIR) UNITDIR=$(UNITDIR) BASHDIR=$(BASHDIR) ZSHDIR=$(ZSHDIR) PYTHONDIR=$(PYTHONDIR) TLS_LIBS='$(TLS_LIBS)' \
	sh clients/packaging/install.sh

# The socket's group is for root and where systemd looks for units. A file says that `install` has made it.
SYSTEM_PREFIXES ?= /usr /usr/local
MAKES_GROUP = [ "$$(id -u),$(DESTDIR),$(filter $(PREFIX),$(SYSTEM_PREFIXES))" = '0,,$(PREFIX)' ]
GROUP_MADE = $(PREFIX)/lib/sysusers.d/dipoled.made

# The tables in proto/*.md, from proto/*.def.
$(BUILD)/wire-lists: $(OBJ)/proto/tools/wire_lists.o $(BUILD)/libproto.a $(BUILD)/libcore.a
PROGRAMS += $(BUILD)/wire-lists

.PHONY: docs manuals install uninstall deb check-deb container

docs: $(BUILD)/wire-lists ## the tables in proto/*.md, from proto/*.def, and the manual pages
	@sh .ci/install-packages docs
	$(BUILD)/wire-lists | $(PYTHON) proto/tools/wire_tables.py .
	@$(MAKE) --no-print-directory -j2 manuals

# The manual pages stand among the sources, so that installing runs none of the built programs.
# `make docs` makes them.
manuals: $(BUILD)/dipoled $(BUILD)/dipole
	$(Q)PYTHONDONTWRITEBYTECODE=1 $(PYTHON) clients/packaging/manuals.py $(BUILD) clients/packaging/man

install: $(INSTALLED) $(LIBRARIES) ## to $(DESTDIR)$(PREFIX)
	$(Q)$(INSTALL_FILES) install
	$(Q)[ -n "$(DESTDIR)" ] || [ "$$(id -u)" != 0 ] || ldconfig
	$(Q)! $(MAKES_GROUP) || getent group dipole >/dev/null || ! command -v systemd-sysusers >/dev/null || \
		{ systemd-sysusers '$(PREFIX)/lib/sysusers.d/dipoled.conf' && touch '$(GROUP_MADE)'; }
	@printf 'Installed in %s%s: programs in %s, library in %s, Python module in %s\n' \
		'$(DESTDIR)' '$(PREFIX)' '$(BINDIR)' '$(LIBDIR)' '$(PYTHONDIR)'

# With the same PREFIX, DESTDIR and the like.
uninstall: ## takes it away again
	$(Q)! $(MAKES_GROUP) || [ ! -e '$(GROUP_MADE)' ] || { groupdel dipole; rm '$(GROUP_MADE)'; }
	$(Q)$(INSTALL_FILES) uninstall
	$(Q)[ -n "$(DESTDIR)" ] || [ "$$(id -u)" != 0 ] || ldconfig

# The packages and the source package, in DEB. They are built from a copy of the sources with Debian's
# flags; with REUSE=yes the copy takes what is in BUILD over, which the tests do.
DEB ?= $(BUILD)/deb
DEB_TREE = $(DEB)/dipoled-$(VERSION)
deb: ## Debian packages, in build/deb
	@sh .ci/install-packages deb
	@rm -rf $(DEB)
	@mkdir -p $(DEB_TREE)
	@tar -c --exclude-vcs --exclude=./build --exclude='./build-*' --exclude=__pycache__ . | tar -x -C $(DEB_TREE)
	@cp -a clients/packaging/debian $(DEB_TREE)/
	@[ -z "$(REUSE)" ] || cp -al $(BUILD) $(DEB_TREE)/build
	@cd $(DEB_TREE) && env -u MAKEFLAGS -u MFLAGS -u MAKELEVEL DEB_BUILD_OPTIONS=noautodbgsym \
		dpkg-buildpackage -us -uc $(if $(REUSE),-nc -d) >../log 2>&1 || { tail -n 40 ../log >&2; exit 1; }
	@rm -rf $(DEB_TREE)
	@ls $(DEB)/*.deb

# An image with the programs and their libraries alone, by podman or docker.
CONTAINER ?= podman
CONTAINER_NAME ?= dipoled
CONTAINER_FOLDER ?= $(BUILD)/container
container: $(INSTALLED) ## an image of the daemon, by podman or docker
	$(Q)sh clients/packaging/container.sh $(BUILD) $(CONTAINER_FOLDER)
	$(Q)$(CONTAINER) build $(if $(findstring podman,$(CONTAINER)),--format docker) -t $(CONTAINER_NAME) -f $(CONTAINER_FOLDER)/Containerfile $(CONTAINER_FOLDER)

# In a new system: installs them, asks the daemon, and takes them away again.
check-deb: deb ## installs the Debian packages in a new system
	@sh tests/packages/run.sh $(DEB)
