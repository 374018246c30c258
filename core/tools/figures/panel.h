/* panel: one medium of the figures of "A Better Dipole" (d'Eon 2012): a ratio sigma_a / sigma_s'
 * and an eta, with isotropic scattering, and all that is drawn of it.
 *
 * Figure 1 to 16 have a ratio each, and a panel for each eta. Lengths are in mean free paths,
 * 1 / sigma_t'; R per squared mean free path and per power that entered. */
#ifndef FIGURES_PANEL_H
#define FIGURES_PANEL_H

#include <stdbool.h>
#include <stddef.h>

#include "core/core.h"

enum { PANEL_RATIOS = 16, PANEL_ETAS = 11, PANEL_RINGS = 64 };

/* The rings' edges; the radii of all curves are the rings' middles. */
#define PANEL_R_LEAST 0.01
#define PANEL_R_MOST 20.0

enum panel_column {
#define COLUMN(IDENT, name, SOURCE, KIND, model) COLUMN_##IDENT,
#include "core/tools/figures/columns.def"
  COLUMNS
};

enum panel_source { PANEL_WALK, PANEL_CURVE };

typedef struct panel_data {
  size_t ratio, eta;                  /* positions in the lists of them */
  double value[COLUMNS][PANEL_RINGS]; /* NaN: not known, as without Monte Carlo */
  double albedo[COLUMNS];             /* NaN in columns that have none */
  bool wanted;                        /* by the options */
  bool known[PANEL_CURVE + 1];        /* values of each source */
} panel_data;

/* The lists, as written in options and file names, and their values. */
extern const char *const panel_ratio_names[PANEL_RATIOS];
extern const char *const panel_eta_names[PANEL_ETAS];
double panel_ratio(const panel_data *panel);
double panel_eta(const panel_data *panel);

/* Nothing known yet. */
void panel_start(panel_data *panel, size_t ratio, size_t eta);

/* sigma_t' = 1 per mm. */
core_medium panel_medium(const panel_data *panel);

/* The edges of the rings, and of one ring its middle (the geometric mean of its edges). */
core_grid panel_edges(void);
double panel_edge(size_t index); /* 0 to PANEL_RINGS */
double panel_radius(size_t ring);

const char *panel_column_name(size_t column);
enum panel_source panel_column_source(size_t column);
bool panel_column_is_curve(size_t column);  /* no error, no other form of another column */
unsigned panel_column_model(size_t column); /* 0: none */

#endif
