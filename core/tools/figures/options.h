/* options: reads the command line of draw-figures. */
#ifndef FIGURES_OPTIONS_H
#define FIGURES_OPTIONS_H

#include <stdbool.h>
#include <stdint.h>

#include "core/tools/figures/panel.h"

#define FIGURES_PROGRAM "draw-figures"

typedef struct options {
  const char *output;
  uint64_t photons; /* for each eta; 0 means no Monte Carlo */
  size_t threads;   /* 1 to TOOLS_THREADS_MAX */
  bool fresh;       /* true: ignore values that earlier runs have kept */
  bool ratio[PANEL_RATIOS];
  bool eta[PANEL_ETAS];
} options;

/* Reads the options. If one is wrong or help is asked for, prints a text and exits. */
options options_read(int argc, char **argv);

#endif
