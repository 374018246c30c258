#include "core/tools/figures/panel.h"

#include <math.h>
#include <stdlib.h>

enum kind { VALUE, ERROR, EXTRA };

static const struct {
  const char *name;
  enum panel_source source;
  enum kind kind;
  unsigned model;
} columns[COLUMNS] = {
#define COLUMN(IDENT, name, SOURCE, KIND, model) {name, PANEL_##SOURCE, KIND, model},
#include "core/tools/figures/columns.def"
};

const char *const panel_ratio_names[PANEL_RATIOS] = {
    "0.0001", "0.0002", "0.0005", "0.001", "0.002", "0.005", "0.01", "0.02",
    "0.05",   "0.1",    "0.2",    "0.5",   "1",     "2",     "5",    "10"};

const char *const panel_eta_names[PANEL_ETAS] = {"1.0", "1.1", "1.2", "1.3", "1.4", "1.5",
                                                 "1.6", "1.7", "1.8", "1.9", "2.0"};

double panel_ratio(const panel_data *panel) {
  return strtod(panel_ratio_names[panel->ratio], NULL);
}
double panel_eta(const panel_data *panel) {
  return strtod(panel_eta_names[panel->eta], NULL);
}

void panel_start(panel_data *panel, size_t ratio, size_t eta) {
  panel->ratio = ratio;
  panel->eta = eta;
  panel->wanted = false;
  panel->known[PANEL_WALK] = panel->known[PANEL_CURVE] = false;
  for (size_t column = 0; column < COLUMNS; column++) {
    panel->albedo[column] = (double)NAN;
    for (size_t ring = 0; ring < PANEL_RINGS; ring++) {
      panel->value[column][ring] = (double)NAN;
    }
  }
}

core_medium panel_medium(const panel_data *panel) {
  const double ratio = panel_ratio(panel);
  return (core_medium){ratio / (1 + ratio), 1 / (1 + ratio), 0, panel_eta(panel)};
}

core_grid panel_edges(void) {
  return (core_grid){CORE_SPACING_LOGARITHMIC, PANEL_RINGS + 1, PANEL_R_LEAST, PANEL_R_MOST};
}

double panel_edge(size_t index) {
  const core_grid grid = panel_edges();
  double r;
  core_grid_radii_f64(&grid, index, 1, &r);
  return r;
}

double panel_radius(size_t ring) {
  return sqrt(panel_edge(ring) * panel_edge(ring + 1));
}

const char *panel_column_name(size_t column) {
  return columns[column].name;
}
enum panel_source panel_column_source(size_t column) {
  return columns[column].source;
}
bool panel_column_is_curve(size_t column) {
  return columns[column].kind == VALUE;
}
unsigned panel_column_model(size_t column) {
  return columns[column].model;
}
