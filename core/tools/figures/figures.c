/* draw-figures: draws the seventeen figures of "A Better Dipole" (d'Eon 2012) with Monte Carlo and
 * transport added. It writes SVG pages and CSV files with the same values:
 *
 *   parts/          the values of each panel, which a second run reads
 *   figure_NN_log.svg, figure_NN_gamma.svg, figure_NN.csv, figure_NN_albedos.csv
 *   summary.csv     says which model is nearer to transport: see summary.h
 *   monte_carlo_check.csv
 *
 * Figure NN from 1 to 16 has ratio number NN of the list, and a panel for each eta. Figure 17 sets
 * the switches of the dipole one by one, for three ratios and three eta.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "core/tools/figures/curves.h"
#include "core/tools/figures/options.h"
#include "core/tools/figures/page.h"
#include "core/tools/figures/summary.h"
#include "core/tools/figures/table.h"
#include "core/tools/figures/walk.h"
#include "core/tools/tools.h"

enum { PATH_BYTES = 4096, FIGURES = PANEL_RATIOS + 1, WANTED_MAX = PANEL_RATIOS * PANEL_ETAS };

#define PAGE_COST_US 150e3

typedef struct run {
  options options;
  uint64_t batches; /* of Monte Carlo for each eta; 0 means none */
  panel_data panels[PANEL_ETAS][PANEL_RATIOS];
  tools_progress progress;
} run;

static void output_path(const run *all, char path[PATH_BYTES], const char *name) {
  if (snprintf(path, PATH_BYTES, "%s/%s", all->options.output, name) >= PATH_BYTES) {
    tools_fail("%s: the name is too long", all->options.output);
  }
}

/* ---- what has been kept -----------------------------------------------------------------------
 */

static void part_path(const run *all, char path[PATH_BYTES], const panel_data *panel,
                      enum panel_source source) {
  char name[128], photons[32] = "";
  if (source == PANEL_WALK) {
    snprintf(photons, sizeof photons, "_batches_%llu", (unsigned long long)all->batches);
  }
  snprintf(name, sizeof name, "parts/%s_eta_%s_ratio_%s%s.csv",
           source == PANEL_WALK ? "walk" : "curves", panel_eta_names[panel->eta],
           panel_ratio_names[panel->ratio], photons);
  output_path(all, path, name);
}

static bool newer_than_program(const char *path) {
  struct stat file, program;
  if (stat(path, &file) != 0 || stat("/proc/self/exe", &program) != 0) {
    return false;
  }
  return file.st_mtim.tv_sec > program.st_mtim.tv_sec ||
         (file.st_mtim.tv_sec == program.st_mtim.tv_sec &&
          file.st_mtim.tv_nsec > program.st_mtim.tv_nsec);
}

static void recall(run *all, panel_data *panel) {
  char path[PATH_BYTES];
  part_path(all, path, panel, PANEL_WALK);
  if (all->batches > 0) {
    table_recall(path, panel, PANEL_WALK);
  }
  part_path(all, path, panel, PANEL_CURVE);
  if (newer_than_program(path)) {
    table_recall(path, panel, PANEL_CURVE);
  }
}

/* Lists the wanted panels of an eta that lack the values of this source, and returns their number.
 */
static size_t missing(run *all, size_t eta, enum panel_source source, panel_data **panels) {
  size_t count = 0;
  for (size_t ratio = 0; ratio < PANEL_RATIOS; ratio++) {
    panel_data *one = &all->panels[eta][ratio];
    if (one->wanted && !one->known[source] && (source == PANEL_CURVE || all->batches > 0)) {
      panels[count++] = one;
    }
  }
  return count;
}

static void keep(const run *all, panel_data *const *panels, size_t count,
                 enum panel_source source) {
  char path[PATH_BYTES];
  for (size_t i = 0; i < count; i++) {
    part_path(all, path, panels[i], source);
    table_keep(path, panels[i], source);
  }
}

/* ---- what is computed -------------------------------------------------------------------------
 */

static void compute(run *all, size_t eta, enum panel_source source) {
  panel_data *panels[PANEL_RATIOS];
  char stage[64];
  const size_t count = missing(all, eta, source, panels);
  if (count == 0) {
    return;
  }
  snprintf(stage, sizeof stage, "%s, eta %s",
           source == PANEL_WALK ? "Monte Carlo" : "transport and models", panel_eta_names[eta]);
  tools_progress_stage(&all->progress, stage);
  if (source == PANEL_WALK) {
    walk_run(panels, count, all->batches, all->options.threads, &all->progress);
  } else {
    curves_run(panels, count, all->options.threads, &all->progress);
  }
  keep(all, panels, count, source);
}

static double estimated_us(run *all) {
  panel_data *panels[PANEL_RATIOS];
  double us = FIGURES * PAGE_FORMS * PAGE_COST_US;
  for (size_t eta = 0; eta < PANEL_ETAS; eta++) {
    us += CURVES_COST_US * (double)missing(all, eta, PANEL_CURVE, panels);
    if (missing(all, eta, PANEL_WALK, panels) > 0) {
      us += walk_cost_us(panel_eta(panels[0]), all->batches);
    }
  }
  return us;
}

/* ---- what is drawn ----------------------------------------------------------------------------
 */

static const char *const switch_ratios[PAGE_ROWS] = {"0.01", "0.1", "1"};
static const char *const switch_etas[PAGE_COLUMNS - 1] = {"1.0", "1.3", "2.0"};

static void add(page_layout *page, const panel_data *panel, size_t cell) {
  if (panel->wanted) {
    page->panels[page->count] = panel;
    page->cell[page->count++] = cell;
  }
}

static page_layout switches_page(const run *all) {
  page_layout p = {.subject = PAGE_SWITCHES};
  for (size_t eta = 0; eta < PANEL_ETAS; eta++) {
    for (size_t ratio = 0; ratio < PANEL_RATIOS; ratio++) {
      for (size_t cell = 0; cell < PAGE_ROWS * PAGE_COLUMNS; cell++) {
        const size_t row = cell / PAGE_COLUMNS, column = cell % PAGE_COLUMNS;
        if (column < PAGE_COLUMNS - 1 &&
            strcmp(switch_ratios[row], panel_ratio_names[ratio]) == 0 &&
            strcmp(switch_etas[column], panel_eta_names[eta]) == 0) {
          add(&p, &all->panels[eta][ratio], cell);
        }
      }
    }
  }
  return p;
}

/* Makes the layout of a figure, which is counted from 0. */
static page_layout figure_page(const run *all, size_t figure, char *title, size_t bytes) {
  page_layout p = {.subject = PAGE_MODELS};
  if (figure == PANEL_RATIOS) {
    p = switches_page(all);
    snprintf(title, bytes, "Figure 17, the switches of the dipole");
  } else {
    for (size_t eta = 0; eta < PANEL_ETAS; eta++) {
      add(&p, &all->panels[eta][figure], eta);
    }
    snprintf(title, bytes, "Figure %zu, σa / σs′ = %s", figure + 1, panel_ratio_names[figure]);
  }
  p.title = title;
  return p;
}

static void draw(void *context, size_t i) {
  run *all = context;
  const size_t figure = i / PAGE_FORMS;
  const enum page_form form = i % PAGE_FORMS;
  char path[PATH_BYTES], name[64], title[128];
  const page_layout p = figure_page(all, figure, title, sizeof title);
  if (p.count > 0) {
    snprintf(name, sizeof name, "figure_%02zu_%s.svg", figure + 1, page_form_names[form]);
    output_path(all, path, name);
    page_draw(&p, form, path);
    if (form == 0) {
      snprintf(name, sizeof name, "figure_%02zu.csv", figure + 1);
      output_path(all, path, name);
      table_write_figure(path, figure + 1, p.panels, p.count);
      snprintf(name, sizeof name, "figure_%02zu_albedos.csv", figure + 1);
      output_path(all, path, name);
      table_write_albedos(path, figure + 1, p.panels, p.count);
    }
  }
  tools_progress_add(&all->progress, PAGE_COST_US);
}

static void summarize(const run *all, const panel_data **panels, size_t count) {
  char path[PATH_BYTES];
  output_path(all, path, "summary.csv");
  summary_write(path, panels, count);
  output_path(all, path, "monte_carlo_check.csv");
  summary_write_check(path, panels, count, all->batches);
  summary_print(stdout, panels, count, all->batches);
}

/* ---- the run ----------------------------------------------------------------------------------
 */

static size_t start(run *all, const panel_data **wanted) {
  size_t count = 0;
  char path[PATH_BYTES];
  tools_make_folder(all->options.output);
  output_path(all, path, "parts");
  tools_make_folder(path);
  for (size_t ratio = 0; ratio < PANEL_RATIOS; ratio++) {
    for (size_t eta = 0; eta < PANEL_ETAS; eta++) {
      panel_data *one = &all->panels[eta][ratio];
      panel_start(one, ratio, eta);
      one->wanted = all->options.ratio[ratio] && all->options.eta[eta];
      if (one->wanted) {
        wanted[count++] = one;
        if (!all->options.fresh) {
          recall(all, one);
        }
      }
    }
  }
  return count;
}

int main(int argc, char **argv) {
  static run all;
  const panel_data *wanted[WANTED_MAX];
  all.options = options_read(argc, argv);
  all.batches = all.options.photons > 0 ? walk_batches(all.options.photons) : 0;
  tools_require_gnuplot();
  const size_t count = start(&all, wanted);
  tools_progress_start(&all.progress, estimated_us(&all));
  for (size_t eta = 0; eta < PANEL_ETAS; eta++) {
    compute(&all, eta, PANEL_CURVE);
  }
  for (size_t eta = 0; eta < PANEL_ETAS; eta++) {
    compute(&all, eta, PANEL_WALK);
  }
  tools_progress_stage(&all.progress, "pages");
  tools_each(all.options.threads, FIGURES * PAGE_FORMS, draw, &all);
  tools_progress_end(&all.progress);
  summarize(&all, wanted, count);
  return EXIT_SUCCESS;
}
