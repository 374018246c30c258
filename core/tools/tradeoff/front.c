#include "core/tools/tradeoff/front.h"

#include <math.h>
#include <string.h>

#include "core/choose.h"
#include "core/tools/tools.h"

enum { WIDTH = 1640, HEIGHT = 860, TOP = 84, BOTTOM = 64, LEFT = 84, RIGHT = 16, GAP = 96 };
enum { PANELS = 2, MEDIA = NODES_PAPER_ETAS * NODES_PAPER_RATIOS };

static const char *const titles[PANELS] = {"typical: median over radii",
                                           "worst over radii from 0.01 to 20 mean free paths"};
static const char *const colours[] = {"#0072b2", "#d55e00", "#009e73", "#cc79a7"};
enum { COLOURS = sizeof colours / sizeof colours[0] };

typedef struct point {
  double ns;
  double error;
  bool front; /* no other subject beats it */
} point;

typedef struct fronts {
  const subjects *of;
  point points[PANELS][SUBJECTS_MAX]; /* ns is NaN if the subject has no point */
} fronts;

/* ---- points ---------------------------------------------------------------------------------- */

static point make_point(const errors_table *errors, const costs_of *costs, size_t s, size_t panel) {
  double values[MEDIA];
  size_t count = 0;
  for (size_t i = 0; i < MEDIA; i++) {
    const errors_row *row = &errors->rows[i * errors->of->count + s];
    if (!isnan(row->worst)) {
      values[count++] = panel == 0 ? row->median : row->worst;
    }
  }
  if (count == 0 || isnan(costs[s].evaluate_ns)) {
    return (point){(double)NAN, (double)NAN, false};
  }
  return (point){costs[s].evaluate_ns, fmax(tools_median(values, count), ERRORS_LEAST), false};
}

/* Whether a is cheaper or nearer to transport than b and not worse in the other respect.
 * Differences within the variation of measurements count as equal. */
static bool beats(const point *a, const point *b) {
  const double ns = CORE_CHOOSE_COST_ALIKE, error = 1.01;
  return a->ns <= b->ns * ns && a->error <= b->error * error &&
         (a->ns * ns < b->ns || a->error * error < b->error);
}

static void make(fronts *all, const errors_table *errors, const costs_of *costs) {
  all->of = errors->of;
  for (size_t panel = 0; panel < PANELS; panel++) {
    point *points = all->points[panel];
    for (size_t s = 0; s < all->of->count; s++) {
      points[s] = make_point(errors, costs, s, panel);
    }
    for (size_t s = 0; s < all->of->count; s++) {
      points[s].front = !isnan(points[s].ns);
      for (size_t other = 0; other < all->of->count && points[s].front; other++) {
        points[s].front = !beats(&points[other], &points[s]);
      }
    }
  }
}

/* Returns the cheapest subject of the front that costs more than ns, or the number of subjects if
 * there is none. */
static size_t next_of_front(const fronts *all, size_t panel, double ns) {
  const point *points = all->points[panel];
  size_t next = all->of->count;
  for (size_t s = 0; s < all->of->count; s++) {
    if (points[s].front && points[s].ns > ns &&
        (next == all->of->count || points[s].ns < points[next].ns)) {
      next = s;
    }
  }
  return next;
}

/* ---- axes ------------------------------------------------------------------------------------ */

typedef struct axes {
  double ns[2];
  double error[2];
  double x[2]; /* pixels */
  double y[2];
} axes;

static axes make_axes(const fronts *all, size_t panel) {
  axes a = {{(double)INFINITY, 0}, {(double)INFINITY, 0}, {0}, {BOTTOM, HEIGHT - TOP}};
  for (size_t s = 0; s < all->of->count; s++) {
    const point *p = &all->points[panel][s];
    if (!isnan(p->ns)) {
      a.ns[0] = fmin(a.ns[0], p->ns);
      a.ns[1] = fmax(a.ns[1], p->ns);
      a.error[0] = fmin(a.error[0], p->error);
      a.error[1] = fmax(a.error[1], p->error);
    }
  }
  a.ns[0] /= 2;
  a.ns[1] *= 3; /* leaves room for names */
  a.error[0] = a.error[0] / 2;
  a.error[1] *= 2;
  const double width = (double)(WIDTH - LEFT - RIGHT - GAP) / PANELS;
  a.x[0] = LEFT + (width + GAP) * (double)panel;
  a.x[1] = a.x[0] + width;
  return a;
}

static double pixel(const double value[2], const double place[2], double at) {
  return place[0] + (place[1] - place[0]) * log(at / value[0]) / log(value[1] / value[0]);
}

/* ---- names ----------------------------------------------------------------------------------- */

typedef struct box {
  double x[2], y[2];
} box;

/* Names are placed one after another. Each takes the first of PLACES places around its point where
 * it overlaps nothing that is already placed. TURNS counts the places on a side, in steps of a
 * name's height. */
enum { TURNS = 48, PLACES = 4 * TURNS };

#define LETTER_WIDTH 6.4
#define NAME_HEIGHT 13.0

static bool is_free(const box *boxes, size_t count, const box *b) {
  for (size_t i = 0; i < count; i++) {
    if (b->x[0] < boxes[i].x[1] && boxes[i].x[0] < b->x[1] && b->y[0] < boxes[i].y[1] &&
        boxes[i].y[0] < b->y[1]) {
      return false;
    }
  }
  return true;
}

/* Returns the box of a name at one of the places around a point. The places alternate between right
 * and left and move further up and down. */
static box name_box(double x, double y, double width, int place) {
  const int side = place % 2, turn = place / 2 % TURNS;
  const double up = (turn % 2 == 0 ? 0.5 : -0.5) * (turn + turn % 2) * NAME_HEIGHT;
  const double away = 8 + 4 * (double)(turn / 4) + 60 * (double)(place / (2 * TURNS));
  const double left = side == 0 ? x + away : x - away - width;
  return (box){{left, left + width}, {y + up - NAME_HEIGHT / 2, y + up + NAME_HEIGHT / 2}};
}

static void put_name(FILE *script, const axes *a, const fronts *all, size_t panel, size_t s,
                     box *boxes, size_t *count) {
  const point *p = &all->points[panel][s];
  const char *name = all->of->models[all->of->all[s].model].model->name;
  const double x = pixel(a->ns, a->x, p->ns), y = pixel(a->error, a->y, p->error);
  const double width = LETTER_WIDTH * (double)strlen(name) * (p->front ? 1.2 : 1);
  box b = name_box(x, y, width, 0);
  for (int place = 0; place < PLACES; place++) {
    const box other = name_box(x, y, width, place);
    if (other.x[1] < a->x[1] && other.x[0] > a->x[0] && other.y[0] > a->y[0] &&
        other.y[1] < a->y[1] && is_free(boxes, *count, &other)) {
      b = other;
      break;
    }
  }
  boxes[(*count)++] = b;
  const char *colour = colours[(all->of->all[s].evaluator - core_evaluators) % COLOURS];
  const bool right = b.x[0] > x;
  const double middle = 0.5 * (b.y[0] + b.y[1]);
  if (fabs(middle - y) > 2 || fmin(fabs(b.x[0] - x), fabs(b.x[1] - x)) > 10) {
    fprintf(script,
            "set arrow from screen %.5f,%.5f to screen %.5f,%.5f nohead lw 0.5 lc rgb "
            "'#999999'\n",
            x / WIDTH, y / HEIGHT, (right ? b.x[0] - 1 : b.x[1] + 1) / WIDTH, middle / HEIGHT);
  }
  fprintf(script, "set label '%s' at screen %.5f,%.5f %s tc rgb '%s' font ',%s' front\n", name,
          (right ? b.x[0] : b.x[1]) / WIDTH, middle / HEIGHT, right ? "left" : "right", colour,
          p->front ? "11" : "9");
}

/* Whether a subject gets a name. Those of the front do. Otherwise tables get none, as they all cost
 * the same and would crowd one column, and a model gets one name for precisions of equal cost. */
static bool has_name(const fronts *all, size_t panel, size_t s) {
  const point *p = &all->points[panel][s];
  if (isnan(p->ns) || p->front) {
    return !isnan(p->ns);
  }
  for (size_t other = 0; other < s; other++) {
    const point *q = &all->points[panel][other];
    const bool same_model = all->of->all[other].model == all->of->all[s].model;
    if (same_model && q->ns < p->ns * CORE_CHOOSE_COST_ALIKE &&
        p->ns < q->ns * CORE_CHOOSE_COST_ALIKE) {
      return false;
    }
  }
  return all->of->all[s].evaluator->id != CORE_EVALUATOR_LUT;
}

static void put_names(FILE *script, const axes *a, const fronts *all, size_t panel) {
  static box boxes[2 * SUBJECTS_MAX];
  size_t count = 0;
  for (size_t s = 0; s < all->of->count; s++) {
    const point *p = &all->points[panel][s];
    if (!isnan(p->ns)) {
      const double x = pixel(a->ns, a->x, p->ns), y = pixel(a->error, a->y, p->error);
      boxes[count++] = (box){{x - 5, x + 5}, {y - 5, y + 5}};
    }
  }
  for (int front = 1; front >= 0; front--) {
    for (size_t s = 0; s < all->of->count; s++) {
      if (has_name(all, panel, s) && all->points[panel][s].front == front) {
        put_name(script, a, all, panel, s, boxes, &count);
      }
    }
  }
}

/* ---- the picture ----------------------------------------------------------------------------- */

static void put_data(FILE *script, const fronts *all, size_t panel) {
  for (const core_choice *evaluator = core_evaluators; evaluator->name != NULL; evaluator++) {
    fprintf(script, "$points%td << END\n", evaluator - core_evaluators);
    for (size_t s = 0; s < all->of->count; s++) {
      const point *p = &all->points[panel][s];
      if (all->of->all[s].evaluator == evaluator && !isnan(p->ns)) {
        fprintf(script, "%.6g %.6g\n", p->ns, p->error);
      }
    }
    fputs("NaN NaN\nEND\n", script);
  }
  fputs("$front << END\n", script);
  double ns = 0;
  for (size_t s; (s = next_of_front(all, panel, ns)) < all->of->count;) {
    ns = all->points[panel][s].ns;
    fprintf(script, "%.6g %.6g\n", ns, all->points[panel][s].error);
  }
  fputs("END\n", script);
}

static void put_panel(FILE *script, const fronts *all, size_t panel) {
  const axes a = make_axes(all, panel);
  fprintf(script,
          "unset label\nunset arrow\nset title '%s'\nset xrange [%g:%g]\nset yrange [%g:%g]\n"
          "set lmargin at screen %.5f\nset rmargin at screen %.5f\n"
          "set bmargin at screen %.5f\nset tmargin at screen %.5f\n",
          titles[panel], a.ns[0], a.ns[1], a.error[0], a.error[1], a.x[0] / WIDTH, a.x[1] / WIDTH,
          a.y[0] / HEIGHT, a.y[1] / HEIGHT);
  put_names(script, &a, all, panel);
  put_data(script, all, panel);
  fputs("plot $front using 1:2 with steps lw 1.5 lc rgb '#888888' title 'front'", script);
  for (const core_choice *evaluator = core_evaluators; evaluator->name != NULL; evaluator++) {
    fprintf(script, ", $points%td using 1:2 with points pt 7 ps 0.6 lc rgb '%s' title '%s'",
            evaluator - core_evaluators, colours[(evaluator - core_evaluators) % COLOURS],
            evaluator->name);
  }
  fputc('\n', script);
}

static void put(FILE *script, const void *context) {
  const fronts *all = context;
  fputs("set multiplot title \"Error against cost: |R / R_transport - 1|, median over the media of "
        "Figures 1 to 16; at least 1e-7, which is what transport is known to\" font ',16'\n"
        "set grid lt 1 lw 0.6 lc rgb '#dddddd'\nset logscale xy\nset format y '%.0e'\n"
        "set xlabel 'ns per radius (one core, arrays of 4096)'\nset ylabel 'relative error of R'\n"
        "set key bottom left Left reverse samplen 1.5 spacing 1.2\n",
        script);
  for (size_t panel = 0; panel < PANELS; panel++) {
    put_panel(script, all, panel);
  }
  fputs("unset multiplot\n", script);
}

void front_draw(const char *path, const errors_table *errors, const costs_of *costs) {
  static fronts all;
  make(&all, errors, costs);
  tools_draw(path, WIDTH, HEIGHT, put, &all);
}

void front_print(FILE *out, const errors_table *errors, const costs_of *costs) {
  static fronts all;
  make(&all, errors, costs);
  for (size_t panel = 0; panel < PANELS; panel++) {
    fprintf(out, "front, %s:\n", titles[panel]);
    double ns = 0;
    for (size_t s; (s = next_of_front(&all, panel, ns)) < all.of->count;) {
      ns = all.points[panel][s].ns;
      fprintf(out, "  %-18s %-4s %9.3g ns %9.2g\n",
              all.of->models[all.of->all[s].model].model->name, all.of->all[s].evaluator->name, ns,
              all.points[panel][s].error);
    }
  }
}
