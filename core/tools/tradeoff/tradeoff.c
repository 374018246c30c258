/* trade-speed [--output DIR] [--threads N] costs|errors: measures every model of a half space that
 * needs only a medium.
 *
 *   costs    measures the speed of each evaluator, and its error against transport at the media of
 *            the paper. It writes DIR/costs.def, which `make tradeoff` copies to core/, and
 *            DIR/tradeoff.csv, which draw.py reads; see write_csv()
 *   errors   measures the error of each model against transport, for isotropic and for anisotropic
 *            scattering, and of isotropic scattering in place of anisotropic with g near 1. It
 *            writes DIR/model_errors.def, which `make model-errors` copies to core/. Every machine
 *            writes the same file.
 */
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/model_error.h"
#include "core/tools/tools.h"
#include "core/tools/tradeoff/cells.h"
#include "core/tools/tradeoff/costs.h"
#include "core/tools/tradeoff/errors.h"
#include "core/tools/tradeoff/similarity.h"

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

/* ---- files ----------------------------------------------------------------------------------- */

enum { ETAS_A_LINE = 4 };

/* These return ratio k and eta k of the paper's lists. */
static double paper_ratio(size_t k) {
  size_t i = 0;
  while (!nodes_ratio_is_papers(i) || k-- > 0) {
    i++;
  }
  return nodes_ratios[i];
}

static double paper_eta(size_t k) {
  return nodes_eta(2 * k);
}

/* Writes a row for each model, evaluator, ratio and eta of the paper's; fields are empty if a
 * medium is refused. The columns are model, evaluator, ratio, eta, cost_ns, prepare_ns and those of
 * errors_row. */
static void write_csv(const char *path, const errors_table *errors, const costs_of *costs) {
  const subjects *of = errors->of;
  FILE *file = tools_open(path);
  fputs("model,evaluator,ratio,eta,cost_ns,prepare_ns,worst,median,worst_from_1_mfp,albedo_error,"
        "numerical_error\n",
        file);
  for (size_t s = 0; s < of->count; s++) {
    for (size_t ratio = 0; ratio < NODES_PAPER_RATIOS; ratio++) {
      for (size_t eta = 0; eta < NODES_PAPER_ETAS; eta++) {
        const errors_row *row = errors_at_row(errors, eta, ratio, s);
        const double numbers[] = {costs[s].evaluate_ns[0],
                                  costs[s].prepare_ns[0],
                                  row->worst,
                                  row->median,
                                  row->worst_far,
                                  row->albedo,
                                  row->numerical};
        fprintf(file, "%s,%s,%g,%.1f", of->models[of->all[s].model].model->name,
                of->all[s].evaluator->name, paper_ratio(ratio), paper_eta(eta));
        for (size_t i = 0; i < sizeof numbers / sizeof numbers[0]; i++) {
          isnan(numbers[i]) ? fputs(",", file) : fprintf(file, ",%.6g", numbers[i]);
        }
        fputc('\n', file);
      }
    }
  }
  tools_close(file, path);
}

/* ---- the lists of core ----------------------------------------------------------------------- */

static void put_list(FILE *file, const char *name, const double *values, size_t count) {
  for (size_t i = 0; i < count; i++) {
    fprintf(file, "CORE_ERROR_%s(%g)%s", name, values[i],
            i % 3 == 2 || i + 1 == count ? "\n" : " ");
  }
}

static void put_codes(FILE *file, const double worst[NODES_BANDS], double albedo) {
  for (size_t band = 0; band < NODES_BANDS; band++) {
    fprintf(file, "%02x", core_error_code(worst[band]));
  }
  fprintf(file, "%02x", core_error_code(albedo));
}

/* Writes a model's line: a string for each ratio, with the codes for each eta. */
static void put_model(FILE *file, const errors_table *errors, size_t m) {
  const subject_model *model = &errors->of->models[m];
  fprintf(file, "/* %s */\nCORE_ERROR_MODEL(%u, %s", model->model->name, model->model->id,
          model->similarity ? "true" : "false");
  for (size_t ratio = 0; ratio < NODES_RATIOS; ratio++) {
    fputc(',', file);
    for (size_t eta = 0; eta < NODES_ETAS; eta++) {
      const errors_node *node = errors_at_node(errors, eta, ratio, m);
      fputs(eta % ETAS_A_LINE == 0 ? "\n\"" : "", file);
      put_codes(file, node->worst, node->albedo);
      fputs(eta % ETAS_A_LINE == ETAS_A_LINE - 1 || eta + 1 == NODES_ETAS ? "\"" : "", file);
    }
  }
  fputs(")\n", file);
}

/* Writes a model's line: a string for each g and, within it, each ratio, with the symbols for each
 * eta. */
static void put_cells(FILE *file, const subjects *of, size_t m, errors_node *cells) {
  const core_choice *model = of->models[m].model;
  fprintf(file, "/* %s */\nCORE_ERROR_CELLS(%u", model->name, model->id);
  for (size_t g = 0; g < CELLS_GS; g++) {
    for (size_t ratio = 0; ratio < CELLS_RATIOS; ratio++) {
      fputs(",\n\"", file);
      for (size_t eta = 0; eta < CELLS_ETAS; eta++) {
        const errors_node *cell = cells_at(cells, m, g, ratio, eta);
        for (size_t band = 0; band < NODES_BANDS; band++) {
          fputc(core_error_symbol(cell->worst[band]), file);
        }
        fputc(core_error_symbol(cell->albedo), file);
      }
      fputc('"', file);
    }
  }
  fputs(")\n", file);
}

static void put_similarity(FILE *file, size_t k, const similarity_node *nodes) {
  fprintf(file, "CORE_ERROR_SIMILARITY(%g", similarity_gs[k]);
  for (size_t ratio = 0; ratio < SIMILARITY_RATIOS; ratio++) {
    fputs(",\n\"", file);
    put_codes(file, nodes[ratio].worst, nodes[ratio].albedo);
    fputc('"', file);
  }
  fputs(")\n", file);
}

/* Writes an error, rounded up to three digits. */
static void put_error(FILE *file, double error) {
  const double unit = error > 0 ? pow(10, floor(log10(error)) - 2) : 1;
  fprintf(file, ", %.3g", ceil(error / unit * (1 - 1e-12)) * unit);
}

static void put_cost(FILE *file, const errors_table *errors, const costs_of *costs, size_t s) {
  const subjects *of = errors->of;
  const core_choice *model = of->models[of->all[s].model].model;
  double numerical = 0;
  for (size_t i = 0; i < (size_t)NODES_PAPER_ETAS * NODES_PAPER_RATIOS; i++) {
    const double stated = errors->rows[i * of->count + s].numerical;
    numerical = isnan(stated) ? numerical : fmax(numerical, stated);
  }
  fprintf(file, "/* %s, %s */\nCORE_COST(%u, %u", model->name, of->all[s].evaluator->name,
          model->id, of->all[s].evaluator->id);
  put_error(file, numerical);
  put_error(file, costs[s].numerical_least);
  fprintf(file, ", %g", costs[s].tolerance_least);
  for (size_t k = 0; k < CORE_CHOOSE_TOLERANCE_COUNT; k++) {
    fprintf(file, ", {%.3g, %.3g}", costs[s].evaluate_ns[k], costs[s].prepare_ns[k]);
  }
  fputs(")\n", file);
  if (!isnan(costs[s].prepare_with_g_ns)) {
    fprintf(file, "CORE_COST_WITH_G(%u, %u, %.3g)\n", model->id, of->all[s].evaluator->id,
            costs[s].prepare_with_g_ns);
  }
}

static const char errors_head[] =
    "/* Errors that `make model-errors` has measured (core/tools/tradeoff/). core/model_error.h "
    "finds\n"
    " * those of a medium.\n"
    " *\n"
    " * CORE_ERROR_EDGE(mean free paths)   the edges of the bands of radii, rising\n"
    " * CORE_ERROR_RATIO(sigma_a / sigma_s'), CORE_ERROR_ETA(eta)   the nodes of all models, "
    "rising\n"
    " * CORE_ERROR_MODEL(model, similarity, \"...\" for each ratio)   g = 0\n"
    " *   similarity: true if g and sigma_s matter only as sigma_s (1 - g)\n"
    " *   for each eta: for each band the largest |R / R_transport - 1|, then that of the albedo, "
    "as\n"
    " *   codes of core/model_error.h, two hexadecimal digits each\n"
    " * CORE_ERROR_CELL_G(g), CORE_ERROR_CELL_RATIO(sigma_a / sigma_s'), CORE_ERROR_CELL_ETA(eta)\n"
    " *   the edges of the cells of all models, rising\n"
    " * CORE_ERROR_CELLS(model, \"...\" for each g and, within it, each ratio)   other g\n"
    " *   for each eta: the same errors as symbols of core/model_error.h, one character each\n"
    " * CORE_ERROR_G_RATIO(sigma_a / sigma_s')   the nodes of the similarity relation, rising\n"
    " * CORE_ERROR_SIMILARITY(g, \"...\" for each of these ratios)   the same codes, with g "
    "rising\n"
    " */\n"
    "/* clang-format off */\n";

/* The macros of core/model_errors.def and their parameters. */
static const char *const macros[][2] = {
    {"EDGE", "mfp"},      {"RATIO", "ratio"},
    {"ETA", "eta"},       {"MODEL", "model, similarity, ..."},
    {"CELL_G", "g"},      {"CELL_RATIO", "ratio"},
    {"CELL_ETA", "eta"},  {"CELLS", "model, ..."},
    {"G_RATIO", "ratio"}, {"SIMILARITY", "g, ..."},
};

enum { MACROS = sizeof macros / sizeof macros[0] };

/* Writes core/model_errors.def, which core/model_error.c includes. The table has errors->nodes. */
static void write_errors(const char *path, const errors_table *errors, errors_node *cells,
                         similarity_node similarity[SIMILARITY_GS][SIMILARITY_RATIOS]) {
  const subjects *of = errors->of;
  double etas[NODES_ETAS];
  FILE *file = tools_open(path);
  for (size_t i = 0; i < NODES_ETAS; i++) {
    etas[i] = nodes_eta(i);
  }
  fputs(errors_head, file);
  for (size_t i = 0; i < MACROS; i++) {
    fprintf(file, "#ifndef CORE_ERROR_%s\n#define CORE_ERROR_%s(%s)\n#endif\n", macros[i][0],
            macros[i][0], macros[i][1]);
  }
  fputc('\n', file);
  put_list(file, "EDGE", nodes_edges, NODES_BANDS + 1);
  put_list(file, "RATIO", nodes_ratios, NODES_RATIOS);
  put_list(file, "ETA", etas, NODES_ETAS);
  for (size_t m = 0; m < of->model_count; m++) {
    if (of->models[m].model->id != CORE_MODEL_TRANSPORT) {
      put_model(file, errors, m);
    }
  }
  put_list(file, "CELL_G", cells_gs, CELLS_GS + 1);
  put_list(file, "CELL_RATIO", cells_ratios, CELLS_RATIOS + 1);
  put_list(file, "CELL_ETA", cells_etas, CELLS_ETAS + 1);
  for (size_t m = 0; m < of->model_count; m++) {
    if (of->models[m].model->id != CORE_MODEL_TRANSPORT) {
      put_cells(file, of, m, cells);
    }
  }
  put_list(file, "G_RATIO", similarity_ratios, SIMILARITY_RATIOS);
  for (size_t k = 0; k < SIMILARITY_GS; k++) {
    put_similarity(file, k, similarity[k]);
  }
  for (size_t i = 0; i < MACROS; i++) {
    fprintf(file, "%s#undef CORE_ERROR_%s\n", i == 0 ? "\n" : "", macros[i][0]);
  }
  tools_close(file, path);
}

static const char costs_head[] =
    "/* Costs that `make tradeoff` has measured (core/tools/tradeoff/). core/choose.h chooses by "
    "them.\n"
    " *\n"
    " * CORE_COST(model id, evaluator id, numerical error by default, numerical error with the\n"
    " *           least tolerance, the least tolerance, and for each of CORE_CHOOSE_TOLERANCES:\n"
    " *           {ns for a radius, ns to prepare})\n"
    " * CORE_COST_WITH_G(model id, evaluator id, ns to prepare): of `transport` where g is not 0, "
    "so "
    "that\n"
    " *           it comes from its table whatever the tolerance is\n"
    " */\n"
    "/* clang-format off */\n";

/* Writes core/costs.def, which core/choose.c includes. The table has errors->rows. */
static void write_costs(const char *path, const errors_table *errors, const costs_of *costs) {
  FILE *file = tools_open(path);
  fputs(costs_head, file);
  for (size_t s = 0; s < errors->of->count; s++) {
    if (!isnan(costs[s].evaluate_ns[0]) && !isnan(costs[s].numerical_least)) {
      put_cost(file, errors, costs, s);
    }
  }
  fputs("\n#undef CORE_COST\n#undef CORE_COST_WITH_G\n", file);
  tools_close(file, path);
}

/* ---- the run --------------------------------------------------------------------------------- */

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
                       (errors_cost_us(ERRORS_NODES) + cells_cost_us() + similarity_cost_us()) /
                           (double)o->threads);
  errors_measure(&errors, of, ERRORS_NODES, o->threads, &progress);
  errors_node *cells = cells_measure(of, o->threads, &progress);
  similarity_measure(similarity, o->threads, &progress);
  write_errors(in_output(path, o, "model_errors.def"), &errors, cells, similarity);
  tools_progress_end(&progress);
  free(cells);
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
