/* trade-speed [--output DIR] [--threads N] costs|errors: measures every model of a half space that
 * needs only a medium.
 *
 *   costs    measures the speed of each evaluator, and its error against transport at the media of
 *            the paper. It writes DIR/costs.def, which `make tradeoff` copies to core/, and
 *            DIR/tradeoff.csv, which draw.py reads; see write.h
 *   errors   measures the error of each model against transport, and of isotropic scattering in
 *            place of anisotropic. It writes DIR/model_errors.def, which `make model-errors` copies
 *            to core/. Every machine writes the same file.
 */
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/tools/tools.h"
#include "core/tools/tradeoff/write.h"

enum { PATH_BYTES = 4096 };

static const char help[] =
    "usage: trade-speed [OPTION...] costs|errors\n"
    "Measures what models and evaluators cost, or how far models are from radiative transport.\n\n"
    "  --output DIR   folder for the results, default build/tradeoff\n"
    "  --threads N    threads that compare models with transport, default: one for each processor\n"
    "                 (speed is always measured in one thread)\n"
    "  --help         print this text\n";

typedef struct options {
  const char *output;
  size_t threads;
  bool errors; /* true: measure errors; false: costs */
} options;

static options read_options(int argc, char **argv) {
  static const struct option known[] = {{"output", required_argument, NULL, 'o'},
                                        {"threads", required_argument, NULL, 'n'},
                                        {"help", no_argument, NULL, 'h'},
                                        {NULL, 0, NULL, 0}};
  options o = {.output = "build/tradeoff", .threads = tools_processors()};
  for (int c; (c = getopt_long(argc, argv, "", known, NULL)) != -1;) {
    if (c == 'h') {
      fputs(help, stdout);
      exit(EXIT_SUCCESS);
    } else if (c == 'o') {
      o.output = optarg;
    } else if (c == 'n' && atoi(optarg) >= 1 && atoi(optarg) <= TOOLS_THREADS_MAX) {
      o.threads = (size_t)atoi(optarg);
    } else {
      fputs(help, stderr);
      exit(EXIT_FAILURE);
    }
  }
  o.errors = optind < argc && strcmp(argv[optind], "errors") == 0;
  if (optind + 1 != argc || (!o.errors && strcmp(argv[optind], "costs") != 0)) {
    fputs(help, stderr);
    exit(EXIT_FAILURE);
  }
  return o;
}

static const char *in_output(char path[PATH_BYTES], const options *o, const char *name) {
  if (snprintf(path, PATH_BYTES, "%s/%s", o->output, name) >= PATH_BYTES) {
    tools_fail("%s: the name is too long", o->output);
  }
  return path;
}

static void measure_costs(const options *o, const subjects *of) {
  static costs_of costs[SUBJECTS_MAX];
  char path[PATH_BYTES];
  errors_table errors;
  tools_progress progress;
  tools_progress_start(&progress,
                       costs_cost_us() + errors_cost_us(ERRORS_ROWS) / (double)o->threads);
  costs_measure(costs, of, &progress);
  errors_measure(&errors, of, ERRORS_ROWS, o->threads, &progress);
  write_csv(in_output(path, o, "tradeoff.csv"), &errors, costs);
  write_costs(in_output(path, o, "costs.def"), &errors, costs);
  tools_progress_end(&progress);
  errors_free(&errors);
}

static void measure_errors(const options *o, const subjects *of) {
  static similarity_node similarity[SIMILARITY_GS][SIMILARITY_RATIOS];
  char path[PATH_BYTES];
  errors_table errors;
  tools_progress progress;
  tools_progress_start(&progress,
                       (errors_cost_us(ERRORS_NODES) + similarity_cost_us()) / (double)o->threads);
  errors_measure(&errors, of, ERRORS_NODES, o->threads, &progress);
  similarity_measure(similarity, o->threads, &progress);
  write_errors(in_output(path, o, "model_errors.def"), &errors, similarity);
  tools_progress_end(&progress);
  errors_free(&errors);
}

int main(int argc, char **argv) {
  static subjects of;
  const options o = read_options(argc, argv);
  tools_make_folder(o.output);
  subjects_find(&of);
  if (o.errors) {
    measure_errors(&o, &of);
  } else {
    measure_costs(&o, &of);
  }
  for (size_t i = 0; i < of.left_out_count; i++) {
    printf("left out: %s (%s)\n", of.left_out[i].model->name, of.left_out[i].why);
  }
  return EXIT_SUCCESS;
}
