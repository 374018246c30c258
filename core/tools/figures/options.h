/* options: of the command line. */
#ifndef FIGURES_OPTIONS_H
#define FIGURES_OPTIONS_H

#include <stdbool.h>
#include <stdint.h>

#include "core/tools/figures/panel.h"

#define FIGURES_PROGRAM "draw-figures"

typedef struct options {
  const char *output;
  uint64_t photons; /* for each eta; 0: no Monte Carlo */
  size_t threads;   /* 1 to TOOLS_THREADS_MAX */
  bool fresh;
  bool ratio[PANEL_RATIOS];
  bool eta[PANEL_ETAS];
} options;

/* Prints what is wrong, or the help that was asked for, and exits. */
options options_read(int argc, char **argv);

#endif
