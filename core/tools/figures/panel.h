/* panel: holds one medium of the figures of "A Better Dipole" (d'Eon 2012) and all values that are
 * drawn for it. The medium is a ratio sigma_a / sigma_s' and an eta; scattering is isotropic.
 *
 * Each of Figures 1 to 16 has one ratio and a panel for each eta. Lengths are in mean free paths,
 * which are 1 / sigma_t'. R is per squared mean free path and per power that entered. */
#ifndef FIGURES_PANEL_H
#define FIGURES_PANEL_H

#include <stdbool.h>
#include <stddef.h>

#include "core/core.h"

enum { PANEL_RATIOS = 16, PANEL_ETAS = 11, PANEL_RINGS = 64 };

/* The inner edge of the first ring and the outer edge of the last; curves are evaluated at the
 * rings' middles. */
#define PANEL_R_LEAST 0.01
#define PANEL_R_MOST 20.0

enum panel_column {
#define COLUMN(IDENT, name, SOURCE, KIND, model) COLUMN_##IDENT,
#include "core/tools/figures/columns.def"
  COLUMNS
};

enum panel_source { PANEL_WALK, PANEL_CURVE };

typedef struct panel_data {
  size_t ratio, eta;                  /* positions in the lists of names below */
  double value[COLUMNS][PANEL_RINGS]; /* NaN if not known */
  double albedo[COLUMNS];             /* NaN in columns that have none */
  bool wanted;                        /* true if the options ask for this panel */
  bool known[PANEL_CURVE + 1];        /* [source]: true if its columns are filled in */
} panel_data;

/* The ratios and eta as options and file names write them, and their values for a panel. */
extern const char *const panel_ratio_names[PANEL_RATIOS];
extern const char *const panel_eta_names[PANEL_ETAS];
double panel_ratio(const panel_data *panel);
double panel_eta(const panel_data *panel);

/* Initializes a panel with no known values. */
void panel_start(panel_data *panel, size_t ratio, size_t eta);

/* Returns the panel's medium, with sigma_t' = 1 per mm. */
core_medium panel_medium(const panel_data *panel);

/* The edges of all rings, one edge, and the middle of a ring, which is the geometric mean of its
 * two edges. */
core_grid panel_edges(void);
double panel_edge(size_t index); /* index: 0 to PANEL_RINGS */
double panel_radius(size_t ring);

const char *panel_column_name(size_t column);
enum panel_source panel_column_source(size_t column);
bool panel_column_is_curve(size_t column);  /* true for columns of kind VALUE */
unsigned panel_column_model(size_t column); /* 0 if it is not a model's */

#endif
