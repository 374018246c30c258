/* Tissue: the media of a tissue at wavelengths. */
#include "server/jobs/tissue.h"

#include <math.h>

#include "server/jobs/job.h"

struct tissue_job {
  struct job job;
  core_tissue tissue;
  const double *wavelengths; /* [count], in the payload */
  uint32_t count;
};

JOB_STRUCTURE(struct tissue_job, tissue_of)

wire_error tissue_read(core_tissue *tissue, unsigned id, unsigned haemoglobin, const uint8_t *at,
                       uint32_t count) {
  double given[CORE_PROPERTIES_END];
  *tissue = core_tissue_named(id);
  tissue->haemoglobin = haemoglobin;
  for (size_t i = 0; i < CORE_PROPERTIES_END; i++) {
    given[i] = (double)NAN;
  }
  const wire_error error = schema_parse_numbers(at, count, core_properties, given);
  for (size_t i = 0; i < CORE_PROPERTIES_END; i++) {
    tissue->value[i] = isnan(given[i]) ? tissue->value[i] : given[i];
  }
  return error;
}

/* Finds the first fault at a wavelength. */
static core_fault check_wavelengths(const struct tissue_job *of) {
  core_fault fault = core_tissue_check(&of->tissue);
  for (uint32_t i = 0; fault.field == NULL && i < of->count; i++) {
    core_medium medium;
    fault = core_tissue_medium(&of->tissue, of->wavelengths[i], &medium);
    fault.index = i;
  }
  return fault;
}

static enum job_outcome start_tissue(struct job *job, const struct job_request *from) {
  struct tissue_job *of = tissue_of(job);
  wire_tissue_request fixed;
  wire_get_tissue_request(from->payload, &fixed);
  of->wavelengths = (const void *)(from->payload + from->layout.parts[1].at);
  of->count = fixed.wavelength_count;
  const uint8_t *properties = from->payload + from->layout.parts[0].at;
  if (!job_passes(job, tissue_read(&of->tissue, fixed.tissue, fixed.haemoglobin, properties,
                                   fixed.property_count)) ||
      !job_passes(job, job_error(check_wavelengths(of)))) {
    return JOB_REFUSED;
  }
  const wire_tissue_reply reply = {.haemoglobin = fixed.haemoglobin, .wavelength_count = of->count};
  return job_reply(job, &reply);
}

static void put_tissue(struct job *job, uint8_t *at) {
  const struct tissue_job *of = tissue_of(job);
  core_medium *media = (void *)at;
  for (uint32_t i = 0; i < of->count; i++) {
    core_tissue_medium(&of->tissue, of->wavelengths[i], &media[i]); /* was checked */
  }
}

const struct job_kind job_kind_TISSUE = {.request = &schema_tissue_request,
                                         .reply = &schema_tissue_reply,
                                         .start = start_tissue,
                                         .put = put_tissue};
