#include "core/tools/figures/options.h"
#include "core/tools/tools.h"

#include <errno.h>
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PHOTONS 16000000
#define PHOTONS_MAX UINT64_C(1000000000000)

static const char help[] =
    "usage: " FIGURES_PROGRAM " [OPTION...]\n"
    "Draws Figures 1 to 17 of d'Eon 2012, \"A Better Dipole\", and writes their data as CSV.\n"
    "Computed values are kept in DIR/parts; a run computes only those that are missing.\n\n"
    "  --output DIR     folder for figures and data, default build/figures\n"
    "  --photons N      photons for each eta, default 16000000; 0 means no Monte Carlo\n"
    "  --ratios LIST    ratios sigma_a / sigma_s', for example 0.01,1; default all sixteen\n"
    "  --etas LIST      values of eta, for example 1.0,1.4; default all eleven\n"
    "  --threads N      number of threads, default one for each processor\n"
    "  --fresh          compute everything anew (without it, a newer program computes anew\n"
    "                   transport and the models, but keeps Monte Carlo's values)\n"
    "  --help           print this text\n";

static uint64_t number(const char *option, const char *text, uint64_t least, uint64_t most) {
  char *end;
  errno = 0;
  const unsigned long long value = strtoull(text, &end, 10);
  if (*text < '0' || *text > '9' || *end != '\0' || errno != 0 || value < least || value > most) {
    tools_fail("--%s %s: a number from %llu to %llu is needed", option, text,
               (unsigned long long)least, (unsigned long long)most);
  }
  return value;
}

static void choose(const char *option, char *list, const char *const *names, size_t count,
                   bool *chosen) {
  char *rest = NULL;
  memset(chosen, 0, count * sizeof *chosen);
  for (char *item = strtok_r(list, ",", &rest); item != NULL; item = strtok_r(NULL, ",", &rest)) {
    size_t i = 0;
    while (i < count && strcmp(item, names[i]) != 0) {
      i++;
    }
    if (i == count) {
      fprintf(stderr, FIGURES_PROGRAM ": --%s: %s is none of", option, item);
      for (i = 0; i < count; i++) {
        fprintf(stderr, " %s", names[i]);
      }
      fputc('\n', stderr);
      exit(EXIT_FAILURE);
    }
    chosen[i] = true;
  }
}

static options defaults(void) {
  options o = {.output = "build/figures", .photons = PHOTONS, .threads = tools_processors()};
  memset(o.ratio, true, sizeof o.ratio);
  memset(o.eta, true, sizeof o.eta);
  return o;
}

options options_read(int argc, char **argv) {
  static const struct option known[] = {
      {"output", required_argument, NULL, 'o'},  {"photons", required_argument, NULL, 'p'},
      {"ratios", required_argument, NULL, 'r'},  {"etas", required_argument, NULL, 'e'},
      {"threads", required_argument, NULL, 't'}, {"fresh", no_argument, NULL, 'f'},
      {"help", no_argument, NULL, 'h'},          {NULL, 0, NULL, 0}};
  options o = defaults();
  for (int c; (c = getopt_long(argc, argv, "", known, NULL)) != -1;) {
    switch (c) {
    case 'o':
      o.output = optarg;
      break;
    case 'p':
      o.photons = number("photons", optarg, 0, PHOTONS_MAX);
      break;
    case 'r':
      choose("ratios", optarg, panel_ratio_names, PANEL_RATIOS, o.ratio);
      break;
    case 'e':
      choose("etas", optarg, panel_eta_names, PANEL_ETAS, o.eta);
      break;
    case 't':
      o.threads = number("threads", optarg, 1, TOOLS_THREADS_MAX);
      break;
    case 'f':
      o.fresh = true;
      break;
    case 'h':
      fputs(help, stdout);
      exit(EXIT_SUCCESS);
    default:
      fputs(help, stderr);
      exit(EXIT_FAILURE);
    }
  }
  if (optind < argc) {
    tools_fail("%s: no such argument; see --help", argv[optind]);
  }
  return o;
}
