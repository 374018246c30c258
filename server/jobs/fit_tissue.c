/* Fit of a tissue: finds amounts of chromophores and scattering from sets of readings at wavelengths,
 * set by set. The places that they share are prepared on another thread and kept in the cache. */
#include <math.h>
#include <stddef.h>
#include <stdlib.h>

#include "core/fit/spectral.h"
#include "proto/schema.h"
#include "server/jobs/job.h"
#include "server/jobs/tissue.h"

/* Parts of a request and of a reply. */
enum { PROPERTY, SOUGHT, AT, SOURCE, DETECTOR, MHZ, QUANTITY, WAVELENGTH, VALUES, ERRORS };
enum { SETS, ESTIMATES, COVARIANCE, RESIDUALS };

/* Evaluations of a search, on average, and the most radii of a dipole of a small request. */
enum { EVALUATIONS = 60, SMALL_RADII = 8 * JOB_SLICE_RADII };

/* What the places of a request have in common; the arrays at to quantity follow, as in the request. */
struct places {
  uint32_t model, axis, scale, count;
  double g, eta, thickness_mm, detector_na;
};

struct tissue_fit {
  struct job job;
  wire_fit_tissue_request fixed;
  schema_layout layout;
  core_tissue tissue;
  struct lookup lookup;  /* gets the prepared places */
  struct places *places; /* their content, owned */
  core_spectral *search; /* NULL before the first set */
  bool searches;         /* whether `search` has begun with the next set */
  uint64_t evaluation_radii;
  uint64_t fitted; /* how many sets of the part are a success so far */
};

JOB_STRUCTURE(struct tissue_fit, tissue_fit_of)

static const double *numbers_of(const struct tissue_fit *of, unsigned part) {
  return (const double *)(const void *)(of->job.payload + of->layout.parts[part].at);
}

/* ---- places in the cache --------------------------------------------------------------------- */

static core_fit_design design_of(const struct places *places) {
  const double *at = (const double *)(places + 1);
  return (core_fit_design){.model = places->model,
                           .moments = CORE_MOMENTS_EXACT,
                           .g = places->g,
                           .eta = places->eta,
                           .thickness_mm = places->thickness_mm,
                           .axis = places->axis,
                           .count = places->count,
                           .at = at,
                           .source_mm = at + places->count,
                           .detector_mm = at + 2 * (size_t)places->count,
                           .detector_na = places->detector_na,
                           .scale = places->scale,
                           .of_spectra = true,
                           .mhz = at + 3 * (size_t)places->count,
                           .quantity = at + 4 * (size_t)places->count};
}

static core_fault prepare_places(void *thing, const struct cache_key *key, const core_isa *isa,
                                 const atomic_bool *stop) {
  const core_fit_design design = design_of(key->content);
  (void)stop;
  return core_fit_create(thing, isa, &design);
}

static void free_places(void *thing) {
  core_fit_free(*(core_fit **)thing);
}

static uint64_t places_bytes_of(const void *thing) {
  return core_fit_bytes(*(core_fit *const *)thing);
}

static const struct cache_kind places_kind = {.thing_bytes = sizeof(core_fit *),
                                              .prepare = prepare_places,
                                              .free = free_places,
                                              .bytes = places_bytes_of};

static size_t place_bytes(const struct tissue_fit *of) {
  return sizeof(struct places) + 5 * sizeof(double) * (size_t)of->fixed.place_count;
}

/* Gathers and checks the places. */
static wire_error take_places(struct tissue_fit *of) {
  const wire_fit_tissue_request *fixed = &of->fixed;
  const double *value = of->tissue.value;
  of->places = malloc(place_bytes(of));
  if (of->places == NULL) {
    return job_no_memory();
  }
  *of->places = (struct places){fixed->model,
                                fixed->axis,
                                fixed->scale,
                                fixed->place_count,
                                value[CORE_PROPERTY_G],
                                value[CORE_PROPERTY_ETA],
                                value[CORE_PROPERTY_THICKNESS],
                                fixed->detector_na};
  memcpy(of->places + 1, numbers_of(of, AT), place_bytes(of) - sizeof *of->places);
  const core_fit_design design = design_of(of->places);
  const core_fault fault = core_fit_check(&design);
  of->evaluation_radii = (uint64_t)(fault.field == NULL ? core_fit_cost_of(&design).evaluation *
                                                              fixed->wavelength_count
                                                        : 0);
  return job_error(fault);
}

/* ---- starting -------------------------------------------------------------------------------- */

_Static_assert(sizeof(core_sought) == WIRE_BYTES_sought && offsetof(core_sought, low) == 8,
               "what is sought is read in place");

/* Checks what is sought, and prepares the search. */
static wire_error prepare_search(struct tissue_fit *of) {
  const core_spectral_design design = {.tissue = of->tissue,
                                       .sought_count = of->fixed.sought_count,
                                       .sought = (const void *)numbers_of(of, SOUGHT),
                                       .wavelength_count = of->fixed.wavelength_count,
                                       .wavelength_nm = numbers_of(of, WAVELENGTH)};
  const core_fault fault =
      core_spectral_create(&of->search, &design, of->fixed.place_count, of->fixed.scale);
  return fault.field != NULL ? job_fault(fault, fault.index) : wire_error_none();
}

static wire_error check_request(struct tissue_fit *of, const struct job_request *from) {
  of->layout = from->layout;
  wire_get_fit_tissue_request(from->payload, &of->fixed);
  wire_error error =
      tissue_read(&of->tissue, of->fixed.tissue, of->fixed.haemoglobin,
                  of->job.payload + of->layout.parts[PROPERTY].at, of->fixed.property_count);
  error = error.status == WIRE_STATUS_OK ? prepare_search(of) : error;
  return error.status == WIRE_STATUS_OK ? take_places(of) : error;
}

static wire_fit_tissue_reply reply_of(const struct tissue_fit *of) {
  const uint32_t readings = of->fixed.place_count * of->fixed.wavelength_count;
  return (wire_fit_tissue_reply){.count = of->job.parts.count,
                                 .fitted_count = of->fitted,
                                 .reading_count = of->fixed.residuals != 0 ? readings : 0,
                                 .sought_count = (uint16_t)of->fixed.sought_count,
                                 .haemoglobin = of->fixed.haemoglobin,
                                 .g = of->tissue.value[CORE_PROPERTY_G],
                                 .eta = of->tissue.value[CORE_PROPERTY_ETA]};
}

static void release(struct tissue_fit *of) {
  core_spectral_free(of->search);
  free(of->places);
}

static wire_error admit_sets(struct tissue_fit *of) {
  const double radii = EVALUATIONS * (double)of->evaluation_radii * (double)of->fixed.set_count;
  const wire_fit_tissue_reply start = reply_of(of);
  return job_parts_fit(&of->job, &schema_fit_tissue_reply, &start, 1, of->fixed.set_count)
             ? job_admit(&of->job, radii <= SMALL_RADII ? fmin(radii, JOB_SLICE_RADII) : radii,
                         "set_count")
             : wire_error_make(WIRE_STATUS_TOO_LARGE, "residuals",
                               "0: with them a set exceeds max_part_bytes");
}

static enum job_outcome start_tissue_fit(struct job *job, const struct job_request *from) {
  struct tissue_fit *of = tissue_fit_of(job);
  of->places = NULL;
  of->search = NULL;
  of->searches = false;
  of->fitted = 0;
  of->job.parts.count = 0;
  if (!job_passes(job, check_request(of, from)) || !job_passes(job, admit_sets(of))) {
    release(of);
    return JOB_REFUSED;
  }
  job_init_other(job, &of->lookup, from);
  return JOB_NEXT_PART;
}

/* ---- fitting --------------------------------------------------------------------------------- */

_Static_assert(offsetof(core_spectral_result, unknown_count) == WIRE_BYTES_fitted_tissue &&
                   sizeof(core_spectral_estimate) == WIRE_BYTES_tissue_estimate,
               "a result has its layout");

static void put_result(struct tissue_fit *of, const schema_layout *layout,
                       const core_spectral_result *result) {
  uint8_t *payload = of->job.parts.payload;
  const size_t n = result->unknown_count, set = (size_t)of->job.parts.index++;
  memcpy(payload + layout->parts[SETS].at + set * WIRE_BYTES_fitted_tissue, result,
         WIRE_BYTES_fitted_tissue);
  memcpy(payload + layout->parts[ESTIMATES].at + set * n * WIRE_BYTES_tissue_estimate,
         result->unknown, n * WIRE_BYTES_tissue_estimate);
  memcpy(payload + layout->parts[COVARIANCE].at + set * n * n * sizeof(double), result->covariance,
         n * n * sizeof(double));
  of->fitted += result->status == CORE_FIT_STATUS_FITTED;
}

/* Does a step of the next set. */
static enum job_outcome fit_next(struct job *job, uint64_t *spent) {
  struct tissue_fit *of = tissue_fit_of(job);
  const core_fit *places = *(core_fit *const *)lookup_thing(&of->lookup);
  const wire_fit_tissue_reply start = reply_of(of);
  const size_t readings = (size_t)of->fixed.place_count * of->fixed.wavelength_count;
  const size_t set = (size_t)(of->job.parts.first + of->job.parts.index);
  core_spectral_result result;
  schema_layout layout;
  schema_lay_out(&schema_fit_tissue_reply, &start, UINT64_MAX, &layout, NULL);
  double *residuals = (double *)(void *)(of->job.parts.payload + layout.parts[RESIDUALS].at);
  residuals = start.reading_count > 0 ? residuals + of->job.parts.index * readings : NULL;
  of->searches =
      of->searches
          ? core_spectral_step(of->search, &result, residuals)
          : core_spectral_begin(of->search, places, numbers_of(of, VALUES) + set * readings,
                                numbers_of(of, ERRORS) + set * readings, &result, residuals);
  if (!of->searches) {
    put_result(of, &layout, &result);
  }
  *spent += of->evaluation_radii;
  return JOB_GOES_ON;
}

static enum job_outcome step_tissue_fit(struct job *job, uint64_t *budget) {
  struct tissue_fit *of = tissue_fit_of(job);
  enum job_outcome outcome =
      of->lookup.entry != NULL
          ? JOB_GOES_ON
          : job_get(job, &of->lookup, &places_kind, of->places, place_bytes(of), CACHE_SLOW);
  if (outcome != JOB_GOES_ON) {
    return outcome;
  }
  outcome =
      job_part_run(job, budget, EVALUATIONS * of->evaluation_radii, STATS_SETS_FITTED, fit_next);
  if (!job_part_is_done(job)) {
    return outcome;
  }
  const wire_fit_tissue_reply start = reply_of(of);
  of->fitted = 0;
  return job_part_end(job, &schema_fit_tissue_reply, &start);
}

static void end_tissue_fit(struct job *job) {
  struct tissue_fit *of = tissue_fit_of(job);
  lookup_return(&of->lookup);
  release(of);
}

const struct job_kind job_kind_FIT_TISSUE = {.request = &schema_fit_tissue_request,
                                             .start = start_tissue_fit,
                                             .begin_part = job_part_begin,
                                             .step = step_tissue_fit,
                                             .end = end_tissue_fit};
