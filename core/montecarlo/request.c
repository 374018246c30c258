/* Monte Carlo requests: their phase functions and their checks. */
#include <assert.h>
#include <math.h>

#include "core/montecarlo/montecarlo.h"

/* The comparisons are written so that NaN is out of every range. */
static bool in_range(double value, double low, double high) {
  return value >= low && value <= high;
}

static const char phase_ids[] = "1 henyey-greenstein, 2 modified or 3 two-term";
static const char untaken[] = "nothing: this phase function does not take it";

void core_mc_request_medium(core_mc_request *request, const core_medium *layer, size_t count) {
  assert(core_layers_check(layer, count).field == NULL);
  request->sigma_t_per_mm = layer->sigma_a_per_mm + layer->sigma_s_per_mm;
  request->g = layer->g;
  request->eta = layer->eta;
  request->thickness_mm = layer->thickness_mm > 0 ? layer->thickness_mm : (double)INFINITY;
  request->albedo_count = 1;
  request->albedo[0] = layer->sigma_s_per_mm / request->sigma_t_per_mm;
  request->below_count = count - 1;
  for (size_t i = 1; i < count; i++) {
    request->below[i - 1] = layer[i];
    if (layer[i].thickness_mm == 0) {
      request->below[i - 1].thickness_mm = (double)INFINITY;
    }
  }
}

/* ---- the phase function ----------------------------------------------------------------------- */

double core_mc_first_g(const core_mc_request *request) {
  switch (request->phase) {
  case CORE_PHASE_MODIFIED:
    return request->g / request->phase_share;
  case CORE_PHASE_TWO_TERM:
    return (request->g - (1 - request->phase_share) * request->phase_g) / request->phase_share;
  default:
    return request->g;
  }
}

core_fault core_mc_request_parameters(core_mc_request *request, const core_parameters *parameters) {
  for (unsigned id = 1; id < CORE_PARAMETERS_END; id++) {
    const double value = parameters->value[id];
    const bool taken = id == CORE_PARAMETER_PHASE || id == CORE_PARAMETER_PHASE_SHARE ||
                       id == CORE_PARAMETER_PHASE_G || id == CORE_PARAMETER_DETECTOR_NA ||
                       id == CORE_PARAMETER_ETA_BELOW;
    if (!isnan(value) && !taken) {
      return (core_fault){core_choice_by_id(core_parameter_list, id)->name,
                          "nothing: Monte Carlo does not take it", 0};
    }
    const core_fault fault = isnan(value) ? (core_fault){0} : core_parameter_check(id, value);
    if (fault.field != NULL) {
      return fault;
    }
  }
  const double phase = parameters->value[CORE_PARAMETER_PHASE];
  const double share = parameters->value[CORE_PARAMETER_PHASE_SHARE];
  const double g = parameters->value[CORE_PARAMETER_PHASE_G];
  if (!isnan(phase) &&
      (phase != floor(phase) || core_choice_by_id(core_phases, (unsigned)phase) == NULL)) {
    return (core_fault){"phase", phase_ids, 0};
  }
  request->phase = isnan(phase) ? CORE_PHASE_HENYEY_GREENSTEIN : (unsigned)phase;
  if (isnan(share) != (request->phase == CORE_PHASE_HENYEY_GREENSTEIN)) {
    return (core_fault){
        "phase_share",
        isnan(share) ? "1e-6 to 1: the phase functions modified and two-term need it" : untaken, 0};
  }
  if (isnan(g) != (request->phase != CORE_PHASE_TWO_TERM)) {
    return (core_fault){
        "phase_g", isnan(g) ? "-0.9999 to 0.9999: the phase function two-term needs it" : untaken,
        0};
  }
  request->phase_share = isnan(share) ? 0 : share;
  request->phase_g = isnan(g) ? 0 : g;
  const double aperture = parameters->value[CORE_PARAMETER_DETECTOR_NA];
  const double eta_below = parameters->value[CORE_PARAMETER_ETA_BELOW];
  request->aperture = isnan(aperture) ? 0 : aperture;
  request->eta_below = isnan(eta_below) ? 0 : eta_below;
  return (core_fault){0};
}

static core_fault check_phase(const core_mc_request *request) {
  const bool mixed = request->phase == CORE_PHASE_MODIFIED || request->phase == CORE_PHASE_TWO_TERM;
  if (request->phase != 0 && core_choice_by_id(core_phases, request->phase) == NULL) {
    return (core_fault){"phase", phase_ids, 0};
  }
  if (mixed ? !in_range(request->phase_share, CORE_MC_SHARE_MIN, 1) : request->phase_share != 0) {
    return (core_fault){"phase_share", mixed ? "1e-6 to 1" : untaken, 0};
  }
  if (request->phase == CORE_PHASE_TWO_TERM
          ? !in_range(request->phase_g, -CORE_MC_G_MAX, CORE_MC_G_MAX)
          : request->phase_g != 0) {
    return (core_fault){"phase_g", mixed ? "-0.9999 to 0.9999" : untaken, 0};
  }
  if (!in_range(core_mc_first_g(request), -CORE_MC_G_MAX, CORE_MC_G_MAX)) {
    return request->phase == CORE_PHASE_TWO_TERM
               ? (core_fault){"phase_g", "such that the first term's mean cosine is within 0.9999",
                              0}
               : (core_fault){"phase_share", "at least |g| / 0.9999", 0};
  }
  return (core_fault){0};
}

/* ---- checks ----------------------------------------------------------------------------------- */

static core_fault check_layer(size_t i, double sigma_t_per_mm, double g, double eta,
                              double thickness_mm) {
  if (!in_range(sigma_t_per_mm, CORE_SIGMA_T_PRIME_MIN_PER_MM, 2 * CORE_SIGMA_MAX_PER_MM)) {
    return (core_fault){"sigma_t", "1e-15 to 2e15 per mm", i};
  }
  if (!in_range(g, -CORE_MC_G_MAX, CORE_MC_G_MAX)) {
    return (core_fault){"g", "-0.9999 to 0.9999: directions are in single precision", i};
  }
  if (!in_range(eta, CORE_ETA_MIN, CORE_ETA_MAX)) {
    return (core_fault){"eta", "0.001 to 1000", i};
  }
  if (!(thickness_mm == 0 || thickness_mm * sigma_t_per_mm >= CORE_MC_THICKNESS_MIN_MFP)) {
    return (core_fault){"thickness", "0, at least 1e-6 mean free paths, or infinity", i};
  }
  return (core_fault){0};
}

/* What layers need beyond their own ranges. */
static core_fault check_stack(const core_mc_request *request) {
  const double eta_below = request->eta_below;
  const bool layered = request->below_count > 0 || (eta_below != 0 && eta_below != 1);
  double thickness_mm = request->thickness_mm;
  if (request->below_count >= CORE_LAYERS_MAX) {
    return (core_fault){"layer_count", "1 to 8", 0};
  }
  if (eta_below != 0 && !in_range(eta_below, CORE_ETA_MIN, CORE_ETA_MAX)) {
    return (core_fault){"eta_below", "0.001 to 1000", 0};
  }
  if (layered && request->albedo_count != 1) {
    return (core_fault){"albedo_count", "1: layers have an albedo each", 0};
  }
  if (layered && request->phase > CORE_PHASE_HENYEY_GREENSTEIN) {
    return (core_fault){"phase", "1 henyey-greenstein: layers have no other", 0};
  }
  for (size_t i = 0; i < request->below_count; i++) {
    const core_medium *below = &request->below[i];
    if (!(thickness_mm > 0 && isfinite(thickness_mm))) {
      return (core_fault){"thickness", "above 0, and finite above another layer", i};
    }
    if (!(below->sigma_a_per_mm >= 0 && below->sigma_s_per_mm >= 0)) {
      return (core_fault){below->sigma_a_per_mm >= 0 ? "sigma_s" : "sigma_a", "0 to 1e15 per mm",
                          i + 1};
    }
    const core_fault fault = check_layer(i + 1, below->sigma_a_per_mm + below->sigma_s_per_mm,
                                         below->g, below->eta, below->thickness_mm);
    if (fault.field != NULL) {
      return fault;
    }
    thickness_mm = below->thickness_mm;
  }
  return layered && thickness_mm == 0 ? (core_fault){"thickness", "above 0", request->below_count}
                                      : (core_fault){0};
}

static core_fault check_medium(const core_mc_request *request) {
  const core_fault fault =
      check_layer(0, request->sigma_t_per_mm, request->g, request->eta, request->thickness_mm);
  if (fault.field != NULL) {
    return fault;
  }
  if (request->albedo_count < 1 || request->albedo_count > CORE_MC_ALBEDOS_MAX) {
    return (core_fault){"albedo_count", "1 to 16", 0};
  }
  for (size_t i = 0; i < request->albedo_count; i++) {
    if (!in_range(request->albedo[i], 0, 1)) {
      return (core_fault){"albedo", "0 to 1", i};
    }
  }
  return check_stack(request);
}

/* Checks the width of each ring, computed from the rounded edges, so that no ring is empty. */
static core_fault check_ring_widths(const core_grid *edges) {
  enum { SLICE = 64 };
  double r_mm[SLICE + 1];
  for (uint64_t first = 0; first + 1 < edges->count; first += SLICE) {
    const uint64_t left = edges->count - first;
    const size_t n = left < SLICE + 1 ? (size_t)left : SLICE + 1;
    core_grid_radii(edges, first, n, false, r_mm);
    for (size_t i = 0; i + 1 < n; i++) {
      if (!(r_mm[i + 1] - r_mm[i] > CORE_MC_RING_WIDTH_MIN * r_mm[i])) {
        return (core_fault){"radius_stop", "rings wider than 1e-6 of their radius", 0};
      }
    }
  }
  return (core_fault){0};
}

static core_fault check_edges(const core_mc_request *request) {
  const core_grid *edges = &request->edges;
  const bool logarithmic = edges->spacing == CORE_SPACING_LOGARITHMIC;
  if (!logarithmic && edges->spacing != CORE_SPACING_LINEAR) {
    return (core_fault){"radius_spacing", "linear or logarithmic", 0};
  }
  if (edges->count < 2 || edges->count > CORE_MC_RINGS_MAX + 1) {
    return (core_fault){"radius_count", "2 to 4097 edges of rings", 0};
  }
  const core_fault fault = core_grid_check(edges);
  if (fault.field != NULL) {
    return fault;
  }
  if (logarithmic && !(edges->start_mm * request->sigma_t_per_mm >= CORE_MC_RADIUS_MIN_MFP)) {
    return (core_fault){"radius_start", "at least 1e-8 mean free paths (logarithmic)", 0};
  }
  if (!(edges->stop_mm * request->sigma_t_per_mm <= CORE_MC_RADIUS_MAX_MFP &&
        edges->stop_mm * request->sigma_t_per_mm >= CORE_MC_RADIUS_MIN_MFP)) {
    return (core_fault){"radius_stop", "1e-8 to 1e12 mean free paths", 0};
  }
  return check_ring_widths(edges);
}

core_fault core_mc_check(const core_mc_request *request) {
  core_fault fault = check_medium(request);
  if (fault.field == NULL) {
    fault = check_phase(request);
  }
  if (fault.field == NULL) {
    fault = check_edges(request);
  }
  if (fault.field != NULL) {
    return fault;
  }
  if (request->roulette_weight != 0 &&
      !in_range(request->roulette_weight, CORE_MC_ROULETTE_WEIGHT_MIN, 1)) {
    return (core_fault){"roulette_weight", "1e-6 to 1, or 0 for the default", 0};
  }
  if (!in_range(request->aperture, 0, 1)) {
    return (core_fault){"aperture", "0 to 1", 0};
  }
  if (request->scatterings_max != 0 &&
      (request->scatterings_max < 2 || request->scatterings_max > CORE_MC_SCATTERINGS_MAX)) {
    return (core_fault){"scatterings_max", "2 to 2^30, or 0 for the default", 0};
  }
  return (core_fault){0};
}
