#include "core/tools/tradeoff/map.h"

#include <math.h>

#include "core/choose.h"
#include "core/tools/tools.h"

enum { COLUMNS = 3, ROWS = 2, PANELS = COLUMNS * ROWS, NONE = SUBJECTS_MAX };
enum { WIDTH = 1500, HEIGHT = 900, TOP = 84, LEGEND = 220, LEFT = 64, GAP_X = 62, GAP_Y = 92 };

static const double within[COLUMNS] = {0.01, 0.03, 0.1};

typedef struct maps {
  const subjects *of;
  /* position of the subject, or NONE */
  size_t cheapest[PANELS][NODES_PAPER_ETAS][NODES_PAPER_RATIOS];
  size_t media[PANELS][SUBJECTS_MAX]; /* number of media for which the subject is the cheapest */
} maps;

/* ---- choosing -------------------------------------------------------------------------------- */

static double error_of(const errors_row *row, size_t panel) {
  return panel / COLUMNS == 0 ? row->worst : row->worst_far;
}

static size_t cheapest(const errors_table *errors, const costs_of *costs, size_t panel, size_t eta,
                       size_t ratio) {
  const errors_row *rows = errors_at_row(errors, eta, ratio, 0);
  double least_ns = (double)INFINITY, least_error = (double)INFINITY;
  size_t best = NONE;
  for (size_t s = 0; s < errors->of->count; s++) {
    if (error_of(&rows[s], panel) <= within[panel % COLUMNS]) {
      least_ns = fmin(least_ns, costs[s].evaluate_ns);
    }
  }
  for (size_t s = 0; s < errors->of->count; s++) {
    const double error = error_of(&rows[s], panel);
    if (error <= within[panel % COLUMNS] && error < least_error &&
        costs[s].evaluate_ns <= least_ns * CORE_CHOOSE_COST_ALIKE) {
      least_error = error;
      best = s;
    }
  }
  return best;
}

static void make(maps *all, const errors_table *errors, const costs_of *costs) {
  *all = (maps){.of = errors->of};
  for (size_t panel = 0; panel < PANELS; panel++) {
    for (size_t eta = 0; eta < NODES_PAPER_ETAS; eta++) {
      for (size_t ratio = 0; ratio < NODES_PAPER_RATIOS; ratio++) {
        const size_t s = cheapest(errors, costs, panel, eta, ratio);
        all->cheapest[panel][eta][ratio] = s;
        if (s != NONE) {
          all->media[panel][s]++;
        }
      }
    }
  }
}

static bool appears(const maps *all, size_t s) {
  size_t media = 0;
  for (size_t panel = 0; panel < PANELS; panel++) {
    media += all->media[panel][s];
  }
  return media > 0;
}

/* ---- drawing --------------------------------------------------------------------------------- */

/* Returns a subject's colour. Subjects that appear on a map get the colours in the order of the
 * list. */
static unsigned colour(const maps *all, size_t s) {
  static const unsigned colours[] = {0xc7c7c7, 0x0072b2, 0xe69f00, 0x009e73, 0xcc79a7, 0x56b4e9,
                                     0xd55e00, 0xf0e442, 0x8c564b, 0x9467bd, 0x2ca02c, 0x17becf,
                                     0x7f7f7f, 0xaec7e8, 0xffbb78, 0x98df8a, 0xff9896, 0xc5b0d5};
  size_t position = 1;
  if (all->of->models[all->of->all[s].model].model->id == CORE_MODEL_TRANSPORT) {
    return colours[0] - 0x181818u * (unsigned)(all->of->all[s].evaluator - core_evaluators);
  }
  for (size_t other = 0; other < s; other++) {
    position += appears(all, other);
  }
  return colours[1 + (position - 1) % (sizeof colours / sizeof colours[0] - 1)];
}

static void put_cells(FILE *script, const maps *all, size_t panel) {
  fprintf(script, "$cells%zu << END\n", panel);
  for (size_t eta = 0; eta < NODES_PAPER_ETAS; eta++) {
    for (size_t ratio = 0; ratio < NODES_PAPER_RATIOS; ratio++) {
      const size_t s = all->cheapest[panel][eta][ratio];
      fprintf(script, "%zu %zu %u\n", ratio, eta, s == NONE ? 0xffffffu : colour(all, s));
    }
  }
  fputs("END\n", script);
}

static void put_tics(FILE *script) {
  static const char *const ratios[] = {"1e-4", "",    "", "1e-3", "",  "", "0.01", "",
                                       "",     "0.1", "", "",     "1", "", "",     "10"};
  fputs("set xtics (", script);
  for (size_t i = 0; i < NODES_PAPER_RATIOS; i++) {
    fprintf(script, "%s'%s' %zu", i > 0 ? ", " : "", ratios[i], i);
  }
  fputs(") out nomirror\nset ytics (", script);
  for (size_t i = 0; i < NODES_PAPER_ETAS; i++) {
    fprintf(script, "%s'%.1f' %zu", i > 0 ? ", " : "", nodes_eta(2 * i), i);
  }
  fputs(") out nomirror\n", script);
}

static void put_panel(FILE *script, const maps *all, size_t panel) {
  const double width = (double)(WIDTH - LEFT) / COLUMNS;
  const double height = (double)(HEIGHT - TOP - LEGEND + GAP_Y) / ROWS;
  const double x = LEFT + width * (double)(panel % COLUMNS);
  const double y = HEIGHT - TOP - height * (double)(panel / COLUMNS);
  put_cells(script, all, panel);
  fprintf(script, "set title 'within %g %%, r from %g to %g mean free paths' offset 0,-0.5\n",
          within[panel % COLUMNS] * 100, panel / COLUMNS == 0 ? nodes_edges[0] : ERRORS_FAR,
          nodes_edges[NODES_BANDS]);
  fprintf(script,
          "set lmargin at screen %.5f\nset rmargin at screen %.5f\nset tmargin at screen %.5f\n"
          "set bmargin at screen %.5f\n",
          x / WIDTH, (x + width - GAP_X) / WIDTH, y / HEIGHT, (y - height + GAP_Y) / HEIGHT);
  fprintf(script,
          "set xrange [-0.5:%d.5]\nset yrange [-0.5:%d.5]\n"
          "plot $cells%zu using 1:2:(0.5):(0.5):3 with boxxyerror fill solid 1 noborder "
          "fillcolor rgb variable notitle\n",
          NODES_PAPER_RATIOS - 1, NODES_PAPER_ETAS - 1, panel);
}

/* Writes a square and a name for each subject that appears, four to a line. */
static void put_legend(FILE *script, const maps *all) {
  size_t position = 0;
  for (size_t s = 0; s < all->of->count; s++) {
    if (appears(all, s)) {
      const double x = LEFT + (double)(position % 4) * 350;
      const double y = LEGEND - 96 - (double)(position / 4) * 24;
      fprintf(script,
              "set object rectangle from screen %.5f,%.5f to screen %.5f,%.5f fc rgb %u "
              "fs solid border rgb '#666666'\n",
              x / WIDTH, (y - 7) / HEIGHT, (x + 22) / WIDTH, (y + 7) / HEIGHT, colour(all, s));
      fprintf(script, "set label '%s, %s' at screen %.5f,%.5f left\n",
              all->of->models[all->of->all[s].model].model->name, all->of->all[s].evaluator->name,
              (x + 30) / WIDTH, y / HEIGHT);
      position++;
    }
  }
}

static void put(FILE *script, const void *context) {
  const maps *all = context;
  fputs("set multiplot title 'The cheapest that is near enough to transport at all of these radii' "
        "font ',16'\nunset key\nset xlabel 'σa / σs′' offset 0,0.6\nset ylabel 'η' offset 1,0\n",
        script);
  put_tics(script);
  for (size_t panel = 0; panel < PANELS; panel++) {
    if (panel == PANELS - 1) {
      put_legend(script, all);
    }
    put_panel(script, all, panel);
  }
  fputs("unset multiplot\n", script);
}

void map_draw(const char *path, const errors_table *errors, const costs_of *costs) {
  static maps all;
  make(&all, errors, costs);
  tools_draw(path, WIDTH, HEIGHT, put, &all);
}

void map_print(FILE *out, const errors_table *errors, const costs_of *costs) {
  static maps all;
  make(&all, errors, costs);
  for (size_t panel = 0; panel < PANELS; panel++) {
    fprintf(out, "cheapest within %g %%, r from %g to %g mfp, of %d media:",
            within[panel % COLUMNS] * 100, panel / COLUMNS == 0 ? nodes_edges[0] : ERRORS_FAR,
            nodes_edges[NODES_BANDS], NODES_PAPER_ETAS * NODES_PAPER_RATIOS);
    for (size_t s = 0; s < all.of->count; s++) {
      if (all.media[panel][s] > 0) {
        fprintf(out, " %s/%s %zu", all.of->models[all.of->all[s].model].model->name,
                all.of->all[s].evaluator->name, all.media[panel][s]);
      }
    }
    fputc('\n', out);
  }
}
