#include "core/tools/figures/curves.h"

#include <math.h>

#include "core/tools/tools.h"
#include "core/transport/transport.h"

#define TRANSPORT_TOLERANCE 1e-7
#define MODEL_TOLERANCE 1e-6 /* for models with a tolerance */

/* Gauss and Legendre's rule with 4 nodes on [-1, 1] (Abramowitz and Stegun 1964, 25.4.29). */
enum { NODES = 4 };
static const double node[NODES] = {-0.861136311594053, -0.339981043584856, 0.339981043584856,
                                   0.861136311594053};
static const double weight[NODES] = {0.347854845137454, 0.652145154862546, 0.652145154862546,
                                     0.347854845137454};

/* Returns the mean of R over a ring, which is what Monte Carlo measures: the integral of 2 pi r R
 * dr divided by the ring's area, with ln r as the variable. A difference of two energies would have
 * no digits left in the tail. */
static double ring_mean(const transport_solution *solution, size_t ring) {
  const double from = panel_edge(ring), to = panel_edge(ring + 1);
  const double middle = log(from * to) / 2, half = log(to / from) / 2;
  double energy = 0;
  for (size_t i = 0; i < NODES; i++) {
    const double r = exp(middle + half * node[i]);
    energy += half * weight[i] * 2 * (double)M_PI * r * r * transport_at(solution, r).R.value;
  }
  return energy / ((double)M_PI * (to - from) * (to + from));
}

static void fill_transport(panel_data *panel, transport_boundary *boundary) {
  transport_solution *solution;
  tools_check(transport_solve(&solution, boundary, panel_medium(panel).sigma_s_per_mm),
              "transport");
  for (size_t i = 0; i < PANEL_RINGS; i++) {
    const transport_number R = transport_at(solution, panel_radius(i)).R;
    panel->value[COLUMN_TRANSPORT][i] = R.value;
    panel->value[COLUMN_TRANSPORT_ERROR][i] = R.error;
    panel->value[COLUMN_TRANSPORT_RING][i] = ring_mean(solution, i);
  }
  const transport_number total = transport_total(solution);
  panel->albedo[COLUMN_TRANSPORT] = total.value;
  panel->albedo[COLUMN_TRANSPORT_ERROR] = total.error;
  transport_solution_free(solution);
}

static void fill_model(panel_data *panel, size_t column) {
  const core_medium medium = panel_medium(panel);
  core_parameters parameters = core_parameters_none();
  parameters.value[CORE_PARAMETER_TOLERANCE] = MODEL_TOLERANCE;
  core_profile profile;
  double r[PANEL_RINGS];
  tools_check(core_profile_prepare(&profile, core_isa_select(NULL), panel_column_model(column),
                                   CORE_MOMENTS_EXACT, CORE_EVALUATOR_F64, &medium, &parameters),
              panel_column_name(column));
  for (size_t i = 0; i < PANEL_RINGS; i++) {
    r[i] = panel_radius(i);
  }
  tools_check(core_radii_range_check_f64(&profile.radii, PANEL_RINGS, r),
              panel_column_name(column));
  core_eval_f64(&profile, CORE_QUANTITY_R, PANEL_RINGS, r, panel->value[column]);
  panel->albedo[column] = profile.albedo;
  core_profile_free(&profile);
}

typedef struct eta_curves {
  panel_data *const *panels;
  transport_boundary *boundary;
  tools_progress *progress;
} eta_curves;

static void fill(void *context, size_t i) {
  const eta_curves *all = context;
  panel_data *panel = all->panels[i];
  fill_transport(panel, all->boundary);
  for (size_t column = 0; column < COLUMNS; column++) {
    if (panel_column_model(column) != 0) {
      fill_model(panel, column);
    }
  }
  panel->known[PANEL_CURVE] = true;
  tools_progress_add(all->progress, CURVES_COST_US);
}

void curves_run(panel_data *const *panels, size_t count, size_t threads, tools_progress *progress) {
  eta_curves all = {.panels = panels, .progress = progress};
  tools_check(transport_boundary_create(&all.boundary, panel_eta(panels[0]), TRANSPORT_TOLERANCE),
              "transport");
  tools_each(threads, count, fill, &all);
  transport_boundary_free(all.boundary);
}
