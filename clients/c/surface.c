/* Fetches, loads and saves surfaces: what evaluating at home needs of a daemon. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"
#include "clients/c/table.h"
#include "proto/table.h"

struct dipole_surface {
  wire_table_reply fixed;
  core_parameters parameters;
  core_varying f64, f32; /* prepared models with these words */
  size_t frame_bytes;
  _Alignas(8) uint8_t frame[]; /* the frame of the reply: header and payload */
};

static core_fault prepare_one(dipole_surface *surface, const core_medium *medium,
                              enum core_evaluator evaluator, const float *words,
                              core_varying *varying) {
  core_varying opened;
  const wire_table_reply *fixed = &surface->fixed;
  const core_fault fault =
      core_varying_open(&opened, core_isa_select(NULL), fixed->model, fixed->moments, evaluator,
                        medium->g, medium->eta, &surface->parameters, words, fixed->word_count);
  if (fault.field == NULL) {
    *varying = opened;
  }
  return fault;
}

/* Prepares the model with the words, which it checks. */
static core_fault prepare(dipole_surface *surface, const core_medium *medium, const float *words) {
  const core_fault fault = prepare_one(surface, medium, CORE_EVALUATOR_F64, words, &surface->f64);
  return fault.field != NULL
             ? fault
             : prepare_one(surface, medium, CORE_EVALUATOR_F32, words, &surface->f32);
}

/* Gives the caller a surface whose frame is filled in. Frees it and fails if it is not intact. */
static bool hand_out(dipole_surface *made, dipole_surface **surface, dipole_error *error) {
  const core_medium *layers;
  const char *wrong = NULL;
  const float *words;
  core_fault fault = {NULL, NULL, 0};
  if (!table_reply_parse(made->frame + WIRE_BYTES_header, made->frame_bytes - WIRE_BYTES_header,
                         &made->fixed, &layers, &made->parameters, &words)) {
    wrong = "its counts or its checksum are wrong";
  } else if (layers->sigma_a_per_mm != 0 || layers->sigma_s_per_mm != 0) {
    wrong = "it is the table of one medium";
  } else if ((fault = prepare(made, layers, words)).field != NULL) {
    wrong = "its words are not those of its model";
  }
  if (wrong == NULL) {
    *surface = made;
    return true;
  }
  dipole_surface_free(made);
  return fault.field != NULL && strcmp(fault.field, CORE_FIELD_MEMORY) == 0
             ? libdipole_fail_memory(error)
             : libdipole_fail(error, DIPOLE_ERROR_TABLE, "this is not an intact surface: %s",
                              wrong);
}

bool dipole_surface_load(const void *bytes, size_t count, dipole_surface **surface,
                         dipole_error *error) {
  size_t frame_bytes;
  error = error != NULL ? error : &(dipole_error){0};
  if (!libdipole_table_check(bytes, count, &frame_bytes, error)) {
    return false;
  }
  dipole_surface *made = malloc(sizeof *made + frame_bytes);
  if (made == NULL) {
    return libdipole_fail_memory(error);
  }
  made->frame_bytes = frame_bytes;
  made->f64 = made->f32 = (core_varying){0};
  memcpy(made->frame, bytes, frame_bytes);
  return hand_out(made, surface, error);
}

/* Returns whether the surface is for this model, moments, g, eta and parameters. */
static bool is_of(const dipole_surface *surface, unsigned model, unsigned moments, double g,
                  double eta, const core_parameters *parameters) {
  const wire_table_reply *own = &surface->fixed;
  bool same = own->model == model && own->moments == moments && surface->f32.g == g &&
              surface->f32.eta == eta;
  for (unsigned id = 0; id < CORE_PARAMETERS_END; id++) {
    const double a = surface->parameters.value[id], b = parameters->value[id];
    same = same && (a == b || (isnan(a) && isnan(b)));
  }
  return same;
}

bool dipole_surface_fetch(dipole_client *client, const dipole_table_query *query,
                          dipole_surface **surface, dipole_error *error) {
  error = error != NULL ? error : &(dipole_error){0};
  if (query->medium.sigma_a_per_mm != 0 || query->medium.sigma_s_per_mm != 0) {
    return libdipole_fail_argument(
        error, "sigma_a and sigma_s of a surface's query are 0: it is for all media");
  }
  libdipole_frame *frame = libdipole_table_request(client, query, error);
  const bool intact =
      frame != NULL &&
      dipole_surface_load(libdipole_frame_bytes(frame),
                          WIRE_BYTES_header + (size_t)frame->payload_bytes, surface, error);
  free(frame);
  return intact || libdipole_table_refuse(client, error);
}

const void *dipole_surface_bytes(const dipole_surface *surface, size_t *count) {
  *count = surface->frame_bytes;
  return surface->frame;
}

const core_varying *libdipole_surface_varying(const dipole_surface *surface,
                                              const varying_request *request) {
  const wire_varying_request *fixed = &request->fixed;
  const core_varying *prepared =
      fixed->evaluator == CORE_EVALUATOR_F64 ? &surface->f64 : &surface->f32;
  return is_of(surface, fixed->model, fixed->moments, fixed->g, fixed->eta, &request->parameters)
             ? prepared
             : NULL;
}

void dipole_surface_free(dipole_surface *surface) {
  if (surface != NULL) {
    core_varying_free(&surface->f64);
    core_varying_free(&surface->f32);
    free(surface);
  }
}
