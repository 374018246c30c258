/* trade-speed [--output DIR] [--table FILE] [--threads N]: measures speed against accuracy for
 * every model of a half space that needs nothing but a medium, and every evaluator:
 *
 *   DIR/tradeoff.csv           see write.h
 *   DIR/front.svg, front.png   see front.h
 *   DIR/map.svg, map.png       see map.h
 *   FILE                       core/tradeoff.def, from which core/choose.c chooses
 */
#include <errno.h>
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/tools/figures/fail.h"
#include "core/tools/figures/gnuplot.h"
#include "core/tools/figures/workers.h"
#include "core/tools/tradeoff/front.h"
#include "core/tools/tradeoff/map.h"
#include "core/tools/tradeoff/write.h"

enum { PATH_BYTES = 4096 };

static const char help[] =
    "usage: trade-speed [OPTION...]\n"
    "Measures what models and evaluators cost and how far they are from radiative transport.\n\n"
    "  --output DIR   of the table and the pictures, default build/tradeoff\n"
    "  --table FILE   default DIR/tradeoff.def; `make tradeoff` copies it to core/\n"
    "  --threads N    of comparing, which is not timed, default: as many as there are processors\n"
    "  --help\n";

typedef struct options {
  const char *output;
  const char *table; /* NULL: in the output */
  size_t threads;
} options;

static options read_options(int argc, char **argv) {
  static const struct option known[] = {{"output", required_argument, NULL, 'o'},
                                        {"table", required_argument, NULL, 't'},
                                        {"threads", required_argument, NULL, 'n'},
                                        {"help", no_argument, NULL, 'h'},
                                        {NULL, 0, NULL, 0}};
  const long processors = sysconf(_SC_NPROCESSORS_ONLN);
  options o = {.output = "build/tradeoff"};
  o.threads = processors < 1 ? 1 : processors > WORKERS_MAX ? WORKERS_MAX : (size_t)processors;
  for (int c; (c = getopt_long(argc, argv, "", known, NULL)) != -1;) {
    if (c == 'h') {
      fputs(help, stdout);
      exit(EXIT_SUCCESS);
    } else if (c == 'o') {
      o.output = optarg;
    } else if (c == 't') {
      o.table = optarg;
    } else if (c == 'n' && atoi(optarg) >= 1 && atoi(optarg) <= WORKERS_MAX) {
      o.threads = (size_t)atoi(optarg);
    } else {
      fputs(help, stderr);
      exit(EXIT_FAILURE);
    }
  }
  if (optind < argc) {
    fail("%s: no such argument; see --help", argv[optind]);
  }
  return o;
}

static const char *in_output(char path[PATH_BYTES], const options *o, const char *name) {
  if (snprintf(path, PATH_BYTES, "%s/%s", o->output, name) >= PATH_BYTES) {
    fail("%s: the name is too long", o->output);
  }
  return path;
}

static void write_all(const options *o, const errors_table *errors, const costs_of *costs) {
  char path[PATH_BYTES];
  write_csv(in_output(path, o, "tradeoff.csv"), errors, costs);
  write_table(o->table != NULL ? o->table : in_output(path, o, "tradeoff.def"), errors, costs);
  front_draw(in_output(path, o, "front"), errors, costs);
  map_draw(in_output(path, o, "map"), errors, costs);
}

int main(int argc, char **argv) {
  static subjects of;
  static costs_of costs[SUBJECTS_MAX];
  errors_table errors;
  progress_bar progress;
  const options o = read_options(argc, argv);
  gnuplot_require();
  if (mkdir(o.output, 0777) != 0 && errno != EEXIST) {
    fail("cannot make the folder %s: %s", o.output, strerror(errno));
  }
  subjects_find(&of);
  progress_start(&progress, costs_cost_us() + errors_cost_us() / (double)o.threads);
  costs_measure(costs, &of, &progress);
  errors_measure(&errors, &of, o.threads, &progress);
  progress_stage(&progress, "pictures");
  write_all(&o, &errors, costs);
  progress_end(&progress);
  for (size_t i = 0; i < of.left_out_count; i++) {
    printf("left out: %s (%s)\n", of.left_out[i].model->name, of.left_out[i].why);
  }
  front_print(stdout, &errors, costs);
  map_print(stdout, &errors, costs);
  errors_free(&errors);
  return EXIT_SUCCESS;
}
