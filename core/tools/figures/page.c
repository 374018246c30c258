#include "core/tools/figures/page.h"
#include "core/tools/tools.h"

#include <math.h>

const char *const page_form_names[PAGE_FORMS] = {"log", "gamma"};

#define GAMMA 2.2
/* The form GAMMA has an axis of values that ends at transport's largest value at the radius
 * R_BRIGHT, in mean free paths. Its axis of radii ends where all of transport's values, as shown,
 * are below R_DARK. */
#define GAMMA_R_BRIGHT 0.2
#define GAMMA_R_DARK 0.04
#define DOT_ERROR_MAX 0.25   /* dots with a larger error, relative to R, are left out */
#define LOG_DECADES_MAX 14.0 /* the longest axis of values */

enum { WIDTH = 1640, HEIGHT = 1200, TOP = 70, BOTTOM = 55, LEFT = 75, GAP_X = 72, GAP_Y = 84 };

typedef struct page_line {
  size_t column;
  const char *title;
  const char *colour;
  int dash;
  double width;
} page_line;

static const page_line model_lines[] = {
    {COLUMN_TRANSPORT, "transport", "#000000", 1, 1.2},
    {COLUMN_CLASSICAL, "classical dipole", "#d55e00", 1, 1.8},
    {COLUMN_BETTER, "better dipole", "#0072b2", 1, 1.8},
    {COLUMN_QUANTIZED, "quantized diffusion", "#009e73", 2, 1.8},
    {COLUMN_QUANTIZED_SINGLE, "quantized + single", "#cc79a7", 2, 1.8},
};

static const page_line switch_lines[] = {
    {COLUMN_TRANSPORT, "transport", "#000000", 1, 1.2},
    {COLUMN_CLASSICAL, "classical dipole", "#d55e00", 1, 1.8},
    {COLUMN_GROSJEAN, "Grosjean D alone", "#56b4e9", 2, 1.8},
    {COLUMN_EXITANCE, "exitance alone", "#009e73", 2, 1.8},
    {COLUMN_BOUNDARY, "boundary alone", "#e69f00", 2, 1.8},
    {COLUMN_BETTER, "all: better dipole", "#0072b2", 1, 1.8},
};

static const struct {
  const page_line *lines;
  size_t count;
} subjects[] = {
    [PAGE_MODELS] = {model_lines, sizeof model_lines / sizeof model_lines[0]},
    [PAGE_SWITCHES] = {switch_lines, sizeof switch_lines / sizeof switch_lines[0]},
};

/* ---- data -------------------------------------------------------------------------------------
 */

static double shown(double R, enum page_form form) {
  return form == PAGE_GAMMA ? pow(R, 1 / GAMMA) : R;
}

/* Writes Monte Carlo's values with a standard error to either side. The ring means are converted to
 * values at the rings' middles by transport's ratio of the two. */
static void put_dots(FILE *script, const panel_data *panel, enum page_form form) {
  fputs("$dots << END\n", script);
  for (size_t i = 0; i < PANEL_RINGS; i++) {
    const double move = panel->value[COLUMN_TRANSPORT][i] / panel->value[COLUMN_TRANSPORT_RING][i];
    const double R = panel->value[COLUMN_MONTE_CARLO][i] * move;
    const double error = panel->value[COLUMN_MONTE_CARLO_ERROR][i] * move;
    if (R > 0 && error < DOT_ERROR_MAX * R) {
      fprintf(script, "%.9g %.9g %.9g %.9g\n", panel_radius(i), shown(R, form),
              shown(R - error, form), shown(R + error, form));
    }
  }
  fputs("NaN NaN NaN NaN\nEND\n", script);
}

static void put_line(FILE *script, const panel_data *panel, size_t column, enum page_form form) {
  fprintf(script, "$line%zu << END\n", column);
  for (size_t i = 0; i < PANEL_RINGS; i++) {
    const double R = panel->value[column][i];
    if (R > 0) {
      fprintf(script, "%.9g %.9g\n", panel_radius(i), shown(R, form));
    }
  }
  fputs("NaN NaN\nEND\n", script);
}

/* ---- axes, the same for all panels of a page --------------------------------------------------
 */

static void transport_range(const page_layout *page, double *least, double *most) {
  *least = (double)INFINITY;
  *most = 0;
  for (size_t p = 0; p < page->count; p++) {
    for (size_t i = 0; i < PANEL_RINGS; i++) {
      *least = fmin(*least, page->panels[p]->value[COLUMN_TRANSPORT][i]);
      *most = fmax(*most, page->panels[p]->value[COLUMN_TRANSPORT][i]);
    }
  }
}

static void put_logarithmic_axes(FILE *script, const page_layout *page) {
  double least, most;
  transport_range(page, &least, &most);
  const double top = ceil(log10(most));
  const double bottom = fmax(floor(log10(least)), top - LOG_DECADES_MAX);
  fprintf(script,
          "set logscale xy\nset format y '%%.0e'\nset xrange [%g:%g]\nset yrange [1e%.0f:1e%.0f]\n",
          PANEL_R_LEAST, PANEL_R_MOST, bottom, top);
}

/* Returns the largest of transport's values, as shown, at the first ring whose middle is r
 * or more. */
static double brightest(const page_layout *page, double r) {
  double most = 0;
  size_t ring = 0;
  while (ring + 1 < PANEL_RINGS && panel_radius(ring) < r) {
    ring++;
  }
  for (size_t p = 0; p < page->count; p++) {
    most = fmax(most, shown(page->panels[p]->value[COLUMN_TRANSPORT][ring], PAGE_GAMMA));
  }
  return most;
}

static void put_gamma_axes(FILE *script, const page_layout *page) {
  static const double ends[] = {2, 3, 5, 7, 10, 15};
  double end = PANEL_R_MOST;
  for (size_t i = sizeof ends / sizeof ends[0];
       i-- > 0 && brightest(page, ends[i]) < GAMMA_R_DARK;) {
    end = ends[i];
  }
  fprintf(script, "set format y '%%g'\nset xrange [0:%g]\nset yrange [0:%.3f]\n", end,
          brightest(page, GAMMA_R_BRIGHT));
}

/* ---- panels -----------------------------------------------------------------------------------
 */

static void put_cell(FILE *script, size_t cell) {
  const double width = (double)(WIDTH - LEFT) / PAGE_COLUMNS;
  const double height = (double)(HEIGHT - TOP - BOTTOM + GAP_Y) / PAGE_ROWS;
  const double x = LEFT + width * (double)(cell % PAGE_COLUMNS);
  const double y = HEIGHT - TOP - height * (double)(cell / PAGE_COLUMNS);
  fprintf(script,
          "set lmargin at screen %.5f\nset rmargin at screen %.5f\nset tmargin at screen %.5f\n"
          "set bmargin at screen %.5f\n",
          x / WIDTH, (x + width - GAP_X) / WIDTH, y / HEIGHT, (y - height + GAP_Y) / HEIGHT);
}

static void put_albedo(FILE *script, size_t row, enum page_form form, const char *colour,
                       const char *text) {
  const double line_height = 0.055;
  const double y =
      form == PAGE_GAMMA ? 0.93 - line_height * (double)row : 0.05 + line_height * (double)row;
  fprintf(script, "set label '%s' at graph %g,%g %s tc rgb '%s' font ',11' front\n", text,
          form == PAGE_GAMMA ? 0.97 : 0.03, y, form == PAGE_GAMMA ? "right" : "left", colour);
}

/* Writes the albedos as text. It begins at the top if the curves leave room there, else at the
 * bottom. */
static void put_albedos(FILE *script, const page_layout *page, const panel_data *panel,
                        enum page_form form) {
  char text[96];
  const size_t count = subjects[page->subject].count;
  const size_t rows = count + 1;
  for (size_t i = 0; i < count; i++) {
    const page_line *line = &subjects[page->subject].lines[i];
    snprintf(text, sizeof text, "%s %.4g", line->title, panel->albedo[line->column]);
    put_albedo(script, form == PAGE_GAMMA ? i + 1 : rows - 2 - i, form, line->colour, text);
  }
  if (panel->known[PANEL_WALK]) {
    snprintf(text, sizeof text, "Monte Carlo %.4g ± %.1g", panel->albedo[COLUMN_MONTE_CARLO],
             panel->albedo[COLUMN_MONTE_CARLO_ERROR]);
    put_albedo(script, form == PAGE_GAMMA ? 0 : rows - 1, form, "#555555", text);
  }
}

static void put_panel(FILE *script, const page_layout *page, size_t index, enum page_form form) {
  const panel_data *panel = page->panels[index];
  const size_t count = subjects[page->subject].count;
  put_cell(script, page->cell[index]);
  fprintf(script, "unset label\nset title 'η = %s", panel_eta_names[panel->eta]);
  if (page->subject == PAGE_SWITCHES) {
    fprintf(script, ", σa / σs′ = %s", panel_ratio_names[panel->ratio]);
  }
  fputs("' offset 0,-0.6\n", script);
  put_albedos(script, page, panel, form);
  put_dots(script, panel, form);
  for (size_t i = 0; i < count; i++) {
    put_line(script, panel, subjects[page->subject].lines[i].column, form);
  }
  fputs("plot ", script);
  for (size_t i = 0; i < count; i++) {
    const page_line *line = &subjects[page->subject].lines[i];
    fprintf(script, "$line%zu using 1:2 with lines lw %g dt %d lc rgb '%s', ", line->column,
            line->width, line->dash, line->colour);
  }
  /* `with yerrorbars` would erase the lines around the dots. */
  fputs("$dots using 1:3:(0):($4-$3) with vectors nohead lw 0.8 lc rgb '#555555', "
        "$dots using 1:2 with points pt 7 ps 0.36 lc rgb '#555555'\n",
        script);
}

static void put_legend(FILE *script, const page_layout *page) {
  put_cell(script, PAGE_COLUMNS * PAGE_ROWS - 1);
  fputs("unset label\nunset title\nunset logscale\nunset border\nunset tics\nunset grid\n"
        "unset xlabel\nset xrange [0:1]\nset yrange [0:1]\n"
        "set key at graph 0.02,0.98 left top Left reverse samplen 3 spacing 1.5 font ',14'\n"
        "plot ",
        script);
  for (size_t i = 0; i < subjects[page->subject].count; i++) {
    const page_line *line = &subjects[page->subject].lines[i];
    fprintf(script, "NaN with lines lw %g dt %d lc rgb '%s' title \"%s\", ", line->width,
            line->dash, line->colour, line->title);
  }
  fputs("NaN with points pt 7 ps 0.5 lc rgb '#555555' title 'Monte Carlo, ± 1 standard error'\n",
        script);
}

struct script {
  const page_layout *page;
  enum page_form form;
};

static void put_script(FILE *script, const void *context) {
  const struct script *what = context;
  const page_layout *page = what->page;
  const enum page_form form = what->form;
  fprintf(script,
          "set multiplot title '%s: %s' font ',17'\nset grid lt 1 lw 0.7 lc rgb '#dddddd'\n"
          "unset key\nset xlabel 'r (mean free paths)' offset 0,0.6\n",
          page->title,
          form == PAGE_GAMMA ? "R to the power 1/2.2" : "R per squared mean free path");
  if (form == PAGE_GAMMA) {
    put_gamma_axes(script, page);
  } else {
    put_logarithmic_axes(script, page);
  }
  for (size_t i = 0; i < page->count; i++) {
    put_panel(script, page, i, form);
  }
  put_legend(script, page);
  fputs("unset multiplot\n", script);
}

void page_draw(const page_layout *page, enum page_form form, const char *path) {
  const struct script script = {page, form};
  tools_draw(path, WIDTH, HEIGHT, put_script, &script);
}
