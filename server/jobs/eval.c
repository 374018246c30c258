#include "server/jobs/eval.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

JOB_STRUCTURE(struct eval_job, eval_of)

static struct stats *stats_of(const struct eval_job *eval) {
  return &eval->job.context->server->stats;
}

/* Returns whether radii and values are of type float; else they are of type double. */
static bool is_single(const struct eval_job *eval) {
  return eval->value_bytes == sizeof(float);
}

/* ---- checking -------------------------------------------------------------------------------- */

/* Checks the media. Sets *radii to the range in which all channels can be evaluated, and covers_all to
 * whether it has all radii. */
static wire_error check_media(struct eval_job *eval, core_radii_range *radii) {
  const wire_eval_request *fixed = &eval->request.fixed;
  const wire_error error = job_check_count(&eval->job, fixed->medium_count);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  if (core_wants_derivatives(fixed->wanted)) {
    eval->request.parameters.value[CORE_PARAMETER_DERIVATIVES] = 1;
  }
  *radii = (core_radii_range){0, (double)INFINITY};
  for (uint32_t channel = 0; channel < fixed->medium_count; channel++) {
    core_radii_range range;
    core_fault fault =
        core_profile_check(fixed->model, fixed->moments, fixed->evaluator,
                           eval_job_medium(eval, channel), &eval->request.parameters, &range);
    const core_medium *last = eval_job_medium(eval, channel) + fixed->layer_count - 1;
    if (fault.field == NULL && (fixed->wanted & CORE_QUANTITY_T) != 0 && last->thickness_mm > 0 &&
        fixed->model != CORE_MODEL_TRANSPORT) {
      fault = (core_fault){"wanted", "no T: this model has only R; transport has both", 0};
    }
    if (fault.field == NULL && (fixed->wanted & CORE_QUANTITY_BALANCE) != 0 &&
        !core_solves(fixed->model)) {
      fault = (core_fault){"wanted", "no balance: this model has only R; transport has it", 0};
    }
    if (fault.field == NULL) {
      fault = core_paths_check(fixed->model, fixed->wanted, eval_job_medium(eval, channel),
                               &eval->request.parameters);
    }
    if (fault.field != NULL) {
      return job_error_behind(fault, (size_t)channel * fixed->layer_count);
    }
    radii->least_mm = fmax(radii->least_mm, range.least_mm);
    radii->most_mm = fmin(radii->most_mm, range.most_mm);
  }
  if ((fixed->wanted & CORE_MODULATED) == 0) {
    eval->request.parameters.value[CORE_PARAMETER_MHZ] = (double)NAN;
  }
  eval->covers_all = radii->least_mm <= 0 && radii->most_mm >= (double)INFINITY;
  return wire_error_none();
}

/* Checks that the model covers the radii: some models are fitted to a range only. */
static wire_error check_range(const struct eval_job *eval, const core_radii_range *range) {
  const wire_eval_request *fixed = &eval->request.fixed;
  if (fixed->spacing == CORE_SPACING_LIST) {
    return job_error(
        core_radii_range_check(range, fixed->radius_count, is_single(eval), eval->request.radii));
  }
  char allowed[80];
  const bool low = fixed->radius_count > 0 && eval->grid.start_mm < range->least_mm;
  const bool high = fixed->radius_count > 1 && eval->grid.stop_mm > range->most_mm;
  if (low) {
    snprintf(allowed, sizeof allowed, "at least fit_from: %.6g mm", range->least_mm);
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "radius_start", allowed);
  }
  if (high) {
    snprintf(allowed, sizeof allowed, "at most fit_to: %.6g mm", range->most_mm);
    return wire_error_make(WIRE_STATUS_BAD_VALUE, "radius_stop", allowed);
  }
  return wire_error_none();
}

/* If only the albedo is wanted, there may be no radii: a grid of 0 radii is accepted. */
static wire_error check_grid(const struct eval_job *eval) {
  const wire_eval_request *fixed = &eval->request.fixed;
  if ((fixed->wanted & CORE_OF_CHANNEL) != 0 && (fixed->wanted & ~CORE_OF_CHANNEL) == 0 &&
      fixed->radius_count == 0) {
    return wire_error_none();
  }
  const core_fault fault = core_grid_check(&eval->grid);
  if (fault.field != NULL && strcmp(fault.field, "radius_count") == 0) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, fault.field, fault.allowed);
  }
  return job_error(fault);
}

/* Checks the radii, and sets eval->radii: the least and the largest of the list, or the ends of the
 * grid, in the precision in which they are evaluated. */
static wire_error check_radii(struct eval_job *eval) {
  const wire_eval_request *fixed = &eval->request.fixed;
  const bool single = is_single(eval);
  if (fixed->spacing == CORE_SPACING_LIST) {
    const core_fault fault =
        single ? core_radii_check_f32(fixed->radius_count, eval->request.radii, &eval->radii)
               : core_radii_check_f64(fixed->radius_count, eval->request.radii, &eval->radii);
    return job_error(fault);
  }
  const wire_error error = check_grid(eval);
  const double start = eval->grid.start_mm;
  const double stop = fixed->radius_count > 1 ? eval->grid.stop_mm : start;
  eval->radii = (core_radii_range){start, stop};
  if (error.status == WIRE_STATUS_OK && single) {
    /* GCC 12 would drop a pair of roundings to float whose results it sees become double again. */
    const float ends[] = {(float)start, (float)stop};
    core_radii_check_f32(2, ends, &eval->radii);
  }
  return error;
}

/* Returns the bits of all wanted quantities, as proto/eval.h defines them. */
static unsigned wanted_of(const struct eval_job *eval) {
  return eval->request.fixed.wanted | (eval->drawn ? EVAL_DRAWN : 0);
}

static const char *count_field(const struct eval_job *eval) {
  return eval->drawn ? "sample_count" : "radius_count";
}

/* Reads the payload and checks the fields on which its layout depends. */
static wire_error parse_request(struct eval_job *eval, const struct job_request *request) {
  const wire_error error =
      eval_request_parse(request->payload, request->header->payload_bytes, &eval->request);
  if (error.status == WIRE_STATUS_OK) {
    const wire_eval_request *fixed = &eval->request.fixed;
    eval->drawn = false;
    eval->value_bytes = core_evaluator_bytes(fixed->evaluator);
    eval->choice = (struct choice_state){.tolerance = (double)NAN};
    eval->grid =
        (core_grid){fixed->spacing, fixed->radius_count, fixed->radius_start, fixed->radius_stop};
  }
  return error;
}

/* Checks a request that names a tolerance in place of a model. */
static wire_error check_tolerance(struct eval_job *eval) {
  wire_error error = job_check_count(&eval->job, eval->request.fixed.medium_count);
  error = error.status == WIRE_STATUS_OK ? choice_check(&eval->request) : error;
  return error.status == WIRE_STATUS_OK ? check_radii(eval) : error;
}

wire_error eval_job_offers(struct eval_job *eval, const struct job_request *request) {
  const wire_error error = parse_request(eval, request);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  return eval->request.fixed.model != EVAL_ANY_MODEL
             ? wire_error_make(WIRE_STATUS_BAD_VALUE, "model", "0: any")
             : check_tolerance(eval);
}

/* Computes the layout of the current part. Returns false if the part would exceed max_bytes. */
static bool lay_out_part(struct eval_job *eval, uint64_t max_bytes) {
  const wire_eval_request *fixed = &eval->request.fixed;
  return eval_reply_layout(fixed->evaluator, wanted_of(eval), fixed->medium_count,
                           eval->job.parts.count, max_bytes, &eval->layout);
}

/* Returns the refusal of a request for which a part of most_bytes is too small. It says how many
 * media would fit, or that even one does not. */
static wire_error no_room_in_part(const struct eval_job *eval, uint64_t most_bytes) {
  const unsigned evaluator = eval->request.fixed.evaluator;
  const unsigned wanted = wanted_of(eval);
  uint32_t media = 0;
  while (eval_part_radii(evaluator, wanted, media + 1, most_bytes) > 0) {
    media++;
  }
  return media > 0 ? job_too_large("medium_count", media, "media fit into a part (max_part_bytes)")
                   : wire_error_make(WIRE_STATUS_TOO_LARGE, "wanted",
                                     "fewer quantities, or radii: they do not fit into a part "
                                     "(max_part_bytes)");
}

/* Cuts the reply into parts and computes the layout of the first. A reply that fits into a frame is
 * one part. A larger reply has parts of up to max_part_bytes, which bounds its memory. */
static wire_error cut_reply(struct eval_job *eval, const struct options *options) {
  const wire_eval_request *fixed = &eval->request.fixed;
  if (fixed->radius_count > options->max_radii) {
    return job_too_large(count_field(eval), options->max_radii, "radii");
  }
  job_parts_cut(&eval->job.parts, fixed->radius_count, fixed->radius_count);
  if (lay_out_part(eval, options->max_frame_bytes)) {
    return wire_error_none();
  }
  const uint64_t most_bytes = options->max_part_bytes;
  const uint64_t most =
      eval_part_radii(fixed->evaluator, wanted_of(eval), fixed->medium_count, most_bytes);
  if (most == 0) {
    return no_room_in_part(eval, most_bytes);
  }
  if ((fixed->radius_count - 1) / most >= UINT32_MAX) { /* more than 2^40 radii in parts of 256 */
    return job_too_large(count_field(eval), UINT32_MAX * most, "radii in parts as small as these");
  }
  job_parts_cut(&eval->job.parts, fixed->radius_count, most);
  const bool fits = lay_out_part(eval, most_bytes);
  assert(fits);
  return wire_error_none();
}

static bool check_request(struct eval_job *eval, const struct job_request *request) {
  struct job *job = &eval->job;
  core_radii_range range;
  return job_passes(job, parse_request(eval, request)) &&
         (eval->request.fixed.model != EVAL_ANY_MODEL ||
          (job_passes(job, check_tolerance(eval)) &&
           job_passes(job, choice_first(&eval->choice, &eval->request, eval->radii)))) &&
         job_passes(job, check_media(eval, &range)) &&
         /* The radii of a request with a tolerance have been checked. */
         (!isnan(eval->choice.tolerance) || job_passes(job, check_radii(eval))) &&
         job_passes(job, check_range(eval, &range));
}

static wire_error check_numbers(const struct eval_job *eval) {
  core_fault fault = core_draw_check(&eval->draw);
  if (fault.field != NULL && strcmp(fault.field, "sample_count") == 0) {
    return wire_error_make(WIRE_STATUS_BAD_COUNT, fault.field, fault.allowed);
  }
  if (fault.field == NULL && eval->request.radii != NULL) {
    fault =
        core_numbers_check(eval->request.fixed.radius_count, is_single(eval), eval->request.radii);
  }
  return job_error(fault);
}

/* Checks a sample request. Any radius may be drawn, so the model must cover all radii. */
static wire_error check_sample(struct eval_job *eval) {
  core_radii_range range;
  /* Any radius may be drawn, 0 included, and the model error at 0 is known only for transport. */
  eval->radii = (core_radii_range){0, 0};
  const wire_error error = check_media(eval, &range);
  if (error.status != WIRE_STATUS_OK) {
    return error;
  }
  return eval->covers_all
             ? check_numbers(eval)
             : wire_error_make(WIRE_STATUS_BAD_VALUE, "model", "a model that covers all radii");
}

/* ---- evaluating a slice ---------------------------------------------------------------------- */

/* Fills the end of an array, behind all its values, with zero bytes. */
static void pad_array(const struct eval_job *eval, uint64_t array_offset) {
  const size_t used = (size_t)eval->job.parts.count * eval->value_bytes;
  memset(eval->reply + array_offset + used, 0, (size_t)eval->layout.array_bytes - used);
}

static void expand_grid(const struct eval_job *eval, size_t n, void *radii) {
  core_grid_radii(&eval->grid, eval->job.parts.first + eval->index, n, is_single(eval), radii);
}

/* Returns the address of the next listed radius, or of the next listed number u of a sample. */
static const uint8_t *listed_radii(const struct eval_job *eval) {
  return (const uint8_t *)eval->request.radii +
         (size_t)(eval->job.parts.first + eval->index) * eval->value_bytes;
}

static void copy_radii(const struct eval_job *eval, size_t n) {
  const size_t offset = (size_t)eval->index * eval->value_bytes;
  uint8_t *to = eval->reply + eval->layout.radius_offset + offset;
  if (eval->request.radii != NULL) {
    memcpy(to, listed_radii(eval), n * eval->value_bytes);
  } else {
    expand_grid(eval, n, to);
  }
}

/* Returns the next n radii: those in the request or in the reply, or else computed from the grid.
 */
static const void *slice_radii(const struct eval_job *eval, size_t n) {
  const size_t offset = (size_t)eval->index * eval->value_bytes;
  if (eval->request.radii != NULL) {
    return listed_radii(eval);
  }
  if (eval->request.fixed.wanted & CORE_QUANTITY_RADIUS) {
    return eval->reply + eval->layout.radius_offset + offset;
  }
  expand_grid(eval, n, eval->job.context->radii);
  return eval->job.context->radii;
}

/* Returns where the channel's next value of a wanted quantity goes in the reply. */
static void *array_of(const struct eval_job *eval, enum core_quantity quantity) {
  return eval->reply + eval_array_offset(&eval->layout, wanted_of(eval), eval->channel, quantity) +
         (size_t)eval->index * eval->value_bytes;
}

/* Draws the next n radii: into the reply if they are wanted, else into scratch memory. */
static const void *draw_radii(const struct eval_job *eval, size_t n) {
  struct job_context *scratch = eval->job.context;
  const bool single = is_single(eval);
  const bool wanted = eval_is_array(wanted_of(eval), CORE_QUANTITY_RADIUS);
  void *r = wanted ? array_of(eval, CORE_QUANTITY_RADIUS) : scratch->radii;
  const void *u = scratch->numbers;
  if (eval->request.radii != NULL) {
    u = listed_radii(eval);
  } else if (single) {
    core_draw_f32(&eval->draw, eval->job.parts.first + eval->index, n,
                  (float *)(void *)scratch->numbers);
  } else {
    core_draw_f64(&eval->draw, eval->job.parts.first + eval->index, n, scratch->numbers);
  }
  if (single) {
    core_sample_f32(&eval->lookup.profile, n, u, r);
  } else {
    core_sample_f64(&eval->lookup.profile, n, u, r);
  }
  return r;
}

/* Returns the cost of one radius of a channel with the cheapest model, in radii of a dipole. */
static uint64_t least_cost(const struct eval_job *eval) {
  const unsigned arrays = eval->layout.arrays_per_channel;
  if (arrays == 0 || !eval->drawn) {
    return arrays;
  }
  const core_profile dipole = {.evaluator = eval->request.fixed.evaluator, .cost = 1};
  return arrays + (uint64_t)core_draw_cost(&dipole);
}

/* Any radius may be drawn. All but this share of the light on either side leaves at the radii for
 * which a sample states its model error. */
#define DRAWN_BEYOND 1e-6

/* Returns the radii for which the channel's model error is stated. */
static core_requested_radii requested_radii(const struct eval_job *eval) {
  if (!eval->drawn) {
    return (core_requested_radii){eval->grid, eval->request.radii, eval->radii};
  }
  const core_profile *profile = &eval->lookup.profile;
  double ends[] = {DRAWN_BEYOND, 1 - DRAWN_BEYOND};
  if (is_single(eval)) {
    const float u[] = {(float)ends[0], (float)ends[1]};
    float r[2];
    core_sample_f32(profile, 2, u, r);
    ends[0] = (double)r[0], ends[1] = (double)r[1];
  } else {
    core_sample_f64(profile, 2, ends, ends);
  }
  const core_grid one = {CORE_SPACING_LINEAR, 1, 0, 0}; /* nothing scatters: all radii are 0 */
  const core_grid many = {CORE_SPACING_LOGARITHMIC, CORE_GRID_COUNT_MAX, ends[0], ends[1]};
  const bool spread = ends[0] > 0 && ends[1] < (double)INFINITY;
  return (core_requested_radii){spread ? many : one, NULL, {0, 0}};
}

/* Returns the profile of transport that the channel is compared with, or NULL. */
static const core_profile *ruler_of(const struct eval_job *eval) {
  return eval->ruler.ready ? &eval->ruler.profile : NULL;
}

/* Where the albedos and errors begin, and their size. They are the same in each part. */
static uint8_t *head_of(const struct eval_job *eval, size_t *bytes) {
  const eval_layout *layout = &eval->layout;
  const uint64_t errors = (uint64_t)eval->request.fixed.medium_count * layout->errors_per_channel;
  *bytes =
      (size_t)(layout->errors_offset + errors * WIRE_BYTES_quantity_error - eval_albedo_offset(0));
  return eval->reply + eval_albedo_offset(0);
}

/* Keeps the albedos and errors of the first part, which the other parts repeat. If memory runs out,
 * the other parts compute them again. */
static void keep_head(struct eval_job *eval) {
  size_t bytes;
  const uint8_t *head = head_of(eval, &bytes);
  eval->head = malloc(bytes);
  if (eval->head != NULL) {
    memcpy(eval->head, head, bytes);
  }
}

/* Returns a model error as replies state it: NAN if it is not known. Here INFINITY means that it is
 * not known. */
static double as_told(double model_error) {
  return isinf(model_error) ? (double)NAN : model_error;
}

/* Writes the channel's albedo and the errors of its quantities. */
static void start_channel(struct eval_job *eval) {
  const core_profile *profile = &eval->lookup.profile;
  eval->notes |= profile->notes;
  if (eval->head != NULL) {
    return; /* start_part() has written them */
  }
  const unsigned listed = eval->request.fixed.wanted;
  const double albedo = (listed & CORE_QUANTITY_ALBEDO) != 0 ? profile->albedo : (double)NAN;
  memcpy(eval->reply + eval_albedo_offset(eval->channel), &albedo, sizeof albedo);
  if ((listed & CORE_QUANTITY_BALANCE) != 0) {
    memcpy(eval->reply + eval->layout.balances_offset + eval->channel * sizeof profile->balance,
           profile->balance, sizeof profile->balance);
  }
  core_requested_radii requested = {.listed = NULL};
  if ((listed & CORE_QUANTITY_MODEL_ERROR) != 0) {
    requested = requested_radii(eval);
  }
  batch_put_errors(profile, ruler_of(eval), wanted_of(eval), eval->radii, &requested,
                   eval->reply + eval_error_offset(&eval->layout, listed, eval->channel, 1));
}

static void start_part(struct eval_job *eval) {
  if (eval->head != NULL) {
    size_t bytes;
    uint8_t *head = head_of(eval, &bytes);
    memcpy(head, eval->head, bytes);
  }
  eval->notes = 0;
  eval->channel = 0;
  eval->index = 0;
  eval->radii_done = eval->drawn || (eval->request.fixed.wanted & CORE_QUANTITY_RADIUS) == 0;
}

static void start_profiles(struct eval_job *eval) {
  const wire_eval_request *fixed = &eval->request.fixed;
  profiles_start(&eval->lookup, fixed->model, fixed->moments, fixed->evaluator,
                 &eval->request.parameters);
}

/* Gets the profile of transport for the current channel, if its model error needs it. MODEL_ERRORS
 * requests it even if it has to be solved. */
static enum lookup_state get_ruler(struct eval_job *eval, const core_medium *medium) {
  const wire_eval_request *fixed = &eval->request.fixed;
  const unsigned compares =
      CORE_QUANTITY_MODEL_ERRORS | (eval->head == NULL ? (unsigned)CORE_QUANTITY_MODEL_ERROR : 0);
  return (fixed->wanted & compares) == 0
             ? LOOKUP_READY
             : profiles_get_ruler(&eval->job.context->profiles, &eval->ruler, fixed->model,
                                  &eval->request.parameters, medium,
                                  (fixed->wanted & CORE_QUANTITY_MODEL_ERRORS) != 0);
}

/* Begins the request again with the next best model for its tolerance. Returns false if there is no
 * other model. */
static bool start_again(struct eval_job *eval) {
  if (!choice_again(&eval->choice, eval->lookup.fault, &eval->request, eval->radii)) {
    return false;
  }
  /* A pass that evaluates the old model may still run: it ends before new values are written. */
  batch_finish(&eval->job.context->batch, stats_of(eval));
  free(eval->head);
  eval->head = NULL;
  start_profiles(eval);
  start_part(eval);
  return true;
}

/* Gets the profile of the current channel. */
static enum job_outcome get_profile(struct eval_job *eval) {
  const core_medium *medium = eval_job_medium(eval, eval->channel);
  enum lookup_state state = get_ruler(eval, medium);
  if (state != LOOKUP_READY) {
    return job_follow(&eval->job, state, &eval->ruler.fault, eval->channel);
  }
  if (choice_heeds_radii(&eval->choice, &eval->request)) {
    const wire_eval_request *fixed = &eval->request.fixed;
    const core_parameters parameters =
        choice_parameters(&eval->choice, &eval->request, medium, eval->radii);
    profiles_start(&eval->lookup, fixed->model, fixed->moments, fixed->evaluator, &parameters);
  }
  state = profiles_get(&eval->job.context->profiles, &eval->lookup, medium);
  if (state == LOOKUP_FAULT && start_again(eval)) {
    return JOB_GOES_ON;
  }
  if (state != LOOKUP_READY) {
    return job_follow(&eval->job, state, &eval->lookup.fault, eval->channel);
  }
  if (!isnan(eval->choice.tolerance) &&
      !choice_keeps(&eval->choice, &eval->request, eval->radii, &eval->lookup.profile, medium,
                    eval->channel)) {
    profiles_return(&eval->lookup);
    return JOB_GOES_ON;
  }
  start_channel(eval);
  return JOB_GOES_ON;
}

/* Writes the model errors at n radii. Single precision is rounded up. */
static void compare_models(const struct eval_job *eval, size_t n, const void *r, void *to) {
  const bool single = is_single(eval);
  const unsigned others = CORE_OF_CHANNEL | CORE_QUANTITY_MODEL_ERRORS | CORE_QUANTITY_RADIUS;
  const unsigned wanted = eval->request.fixed.wanted & ~others;
  for (size_t first = 0; first < n; first += CORE_RULER_RADII) {
    double at[CORE_RULER_RADII], error[CORE_RULER_RADII];
    const size_t count = n - first < CORE_RULER_RADII ? n - first : CORE_RULER_RADII;
    for (size_t i = 0; i < count; i++) {
      at[i] = schema_real_at(r, first + i, single);
    }
    core_model_errors_at(&eval->lookup.profile, ruler_of(eval),
                         wanted != 0 ? wanted : (unsigned)CORE_QUANTITY_R, count, at, error);
    for (size_t i = 0; i < count; i++) {
      schema_put_real(to, first + i, single,
                      as_told(error[i]) * (single ? 1 + (double)FLT_EPSILON : 1));
    }
  }
}

/* Evaluates every wanted array at the n radii of a slice, or adds a short request to the batch. */
static void evaluate_slice(struct eval_job *eval, size_t n) {
  const bool is_short = eval->job.parts.count == n && n <= BATCH_SHORT_RADII && n > 0;
  const void *r = eval->drawn ? draw_radii(eval, n) : slice_radii(eval, n);
  for (unsigned left = eval->request.fixed.wanted; left != 0; left &= left - 1) {
    const unsigned quantity = left & ~(left - 1);
    if ((quantity & CORE_ARRAYS) == 0) {
      continue;
    }
    void *to = array_of(eval, quantity);
    if (is_short && batch_take(&eval->job.context->batch, stats_of(eval), eval->lookup.place,
                               quantity, n, r, to)) {
      continue;
    }
    if (quantity == CORE_QUANTITY_MODEL_ERRORS) {
      compare_models(eval, n, r, to);
    } else if (is_single(eval)) {
      core_eval_f32(&eval->lookup.profile, quantity, n, r, to);
    } else {
      core_eval_f64(&eval->lookup.profile, quantity, n, r, to);
    }
  }
}

/* Pads all arrays of the channel. */
static void pad_channel(const struct eval_job *eval) {
  const uint64_t channel_bytes = eval->layout.arrays_per_channel * eval->layout.array_bytes;
  uint64_t offset = eval->layout.arrays_offset + eval->channel * channel_bytes;
  for (unsigned array = 0; array < eval->layout.arrays_per_channel; array++) {
    pad_array(eval, offset);
    offset += eval->layout.array_bytes;
  }
}

/* Advances by a slice of n radii. Returns true if this was the last slice of its arrays. */
static bool advance_by(struct eval_job *eval, size_t n) {
  eval->index += n;
  if (eval->index < eval->job.parts.count) {
    return false;
  }
  eval->index = 0;
  return true;
}

static void radii_step(struct eval_job *eval, size_t n) {
  copy_radii(eval, n);
  eval->radii_done = advance_by(eval, n);
  if (eval->radii_done) {
    pad_array(eval, eval->layout.radius_offset);
  }
}

/* Writes the start of the part, whose notes are known when all channels have been prepared. */
static void put_start(const struct eval_job *eval) {
  const wire_eval_request *fixed = &eval->request.fixed;
  const wire_eval_reply start = {
      .model = fixed->model,
      .evaluator = fixed->evaluator,
      .moments = fixed->moments,
      .wanted = fixed->wanted,
      .notes = eval->notes,
      .channel_count = fixed->medium_count,
      .count = eval->job.parts.count,
      .first = eval->job.parts.first,
      .part = eval->job.parts.part,
      .part_count = eval->job.parts.part_count,
  };
  wire_put_eval_reply(eval->reply, &start);
}

/* Remembers the request, so that later requests can repeat it with other radii. A request whose
 * check depends on the radii cannot be repeated. */
static void learn_request(const struct eval_job *eval) {
  if (!eval->drawn && eval->covers_all && !choice_heeds_radii(&eval->choice, &eval->request)) {
    repeat_learn(&eval->job.context->repeat, &eval->request, &eval->grid, &eval->layout,
                 eval->reply, eval->channels);
  }
}

static void channel_step(struct eval_job *eval, size_t n) {
  if (eval->layout.arrays_per_channel > 0) {
    evaluate_slice(eval, n);
    job_pay(&eval->job, n * least_cost(eval));
    stats_count_radii(stats_of(eval), eval->request.fixed.model, n);
    stats_add(stats_of(eval), STATS_RADII_DRAWN, eval->drawn ? n : 0);
  }
  if (eval->layout.arrays_per_channel == 0 || advance_by(eval, n)) {
    pad_channel(eval);
    if (eval->channel < REPEAT_CHANNELS) {
      eval->channels[eval->channel] =
          (struct repeat_channel){eval->lookup.place, eval->ruler.place, eval->ruler.ready};
    }
    eval->channel++;
    if (eval->channel == eval->request.fixed.medium_count) {
      put_start(eval);
      learn_request(eval);
    }
    profiles_return(&eval->lookup);
    profiles_return(&eval->ruler);
  }
}

/* Slices of samples are multiples of this, because kernels that draw work on whole vectors. */
enum { DRAW_VECTOR = 8 };

/* fixed: what a slice costs besides its radii. If that is much, the radii may cost as much again. */
static size_t slice_length(const struct eval_job *eval, double fixed, double cost) {
  const uint64_t left = eval->job.parts.count - eval->index;
  size_t most = (size_t)fmax(fmax(JOB_SLICE_RADII - fixed, fixed) / cost, 1);
  if (eval->drawn) {
    most = most < DRAW_VECTOR ? DRAW_VECTOR : most / DRAW_VECTOR * DRAW_VECTOR;
  }
  return left < most ? (size_t)left : most;
}

/* Returns the cost of computing a radius of the grid, in radii of a dipole; 0 for listed radii. One
 * takes 3.6 ns of a linear and 42 ns of a logarithmic grid, a dipole 1.3 (f32) or 3.8 ns (f64). */
static double grid_cost(const struct eval_job *eval) {
  const unsigned spacing = eval->request.fixed.spacing;
  return eval->drawn || spacing == CORE_SPACING_LIST ? 0 : spacing == CORE_SPACING_LINEAR ? 2 : 20;
}

/* Returns the cost of one radius of the channel, in radii of a dipole. */
static double cost_of(const struct eval_job *eval) {
  const core_profile *profile = &eval->lookup.profile;
  const unsigned wanted = eval->request.fixed.wanted;
  const bool in_reply = eval_is_array(wanted_of(eval), CORE_QUANTITY_RADIUS);
  const bool compares = (wanted & CORE_QUANTITY_MODEL_ERRORS) != 0 && eval->ruler.ready;
  return core_radius_cost(profile, wanted) +
         (compares ? core_radius_cost(profile, wanted) +
                         core_radius_cost(&eval->ruler.profile, wanted) * __builtin_popcount(wanted)
                   : 0) +
         (eval->drawn ? core_draw_cost(profile) : 0) + (in_reply ? 0 : grid_cost(eval));
}

/* ---- the job --------------------------------------------------------------------------------- */

/* Starts the job, which has been checked. */
static enum job_outcome admit_eval(struct eval_job *eval, const struct job_request *request) {
  const wire_eval_request *fixed = &eval->request.fixed;
  /* The product is exact: at most 2^40 radii (max_radii), 2^25 media and ten arrays. */
  const double radii = (double)fixed->radius_count * fixed->medium_count;
  struct job *job = &eval->job;
  if (!job_passes(job, cut_reply(eval, &job->context->server->options)) ||
      !job_passes(job, job_admit(job, radii * (double)least_cost(eval), count_field(eval)))) {
    return JOB_REFUSED;
  }
  eval->repeated = NULL;
  eval->head = NULL;
  job_init_lookup(&eval->job, &eval->ruler, request);
  job_init_lookup(&eval->job, &eval->lookup, request);
  start_profiles(eval);
  eval->job.part_bytes = eval->layout.payload_bytes;
  return JOB_NEXT_PART;
}

static enum job_outcome start_eval(struct job *job, const struct job_request *request) {
  struct eval_job *eval = eval_of(job);
  eval->repeated = repeat_find(&job->context->repeat, request->payload,
                               request->header->payload_bytes, &eval->radii);
  if (eval->repeated != NULL) {
    job->latency = LATENCY_EVAL_SHORT;
    job->part_bytes = eval->repeated->reply_bytes;
    return JOB_NEXT_PART;
  }
  if (!check_request(eval, request)) {
    return JOB_REFUSED;
  }
  job->latency = eval->request.fixed.radius_count <= BATCH_SHORT_RADII ? LATENCY_EVAL_SHORT
                                                                       : LATENCY_EVAL_LONG;
  return admit_eval(eval, request);
}

static enum job_outcome start_sample(struct job *job, const struct job_request *request) {
  struct eval_job *eval = eval_of(job);
  if (!job_passes(job, sample_request_parse(request->payload, request->header->payload_bytes,
                                            &eval->draw, &eval->request))) {
    return JOB_REFUSED;
  }
  eval->drawn = true;
  eval->value_bytes = core_evaluator_bytes(eval->request.fixed.evaluator);
  eval->choice = (struct choice_state){.tolerance = (double)NAN};
  return job_passes(job, check_sample(eval)) ? admit_eval(eval, request) : JOB_REFUSED;
}

static enum job_outcome begin_eval_part(struct job *job, uint8_t *payload) {
  struct eval_job *eval = eval_of(job);
  if (eval->repeated != NULL) {
    struct job_context *context = job->context;
    repeat_reply(eval->repeated, &context->batch, stats_of(eval), job->payload, eval->radii,
                 context->radii, payload);
    return JOB_DONE;
  }
  eval->reply = payload;
  start_part(eval);
  return JOB_GOES_ON;
}

/* Ends a part. If another part follows, computes its layout. */
static enum job_outcome end_part(struct eval_job *eval) {
  const bool is_first = eval->job.parts.part == 0;
  if (!job_parts_next(&eval->job.parts)) {
    return JOB_DONE;
  }
  if (is_first) {
    keep_head(eval);
  }
  const bool fits = lay_out_part(eval, UINT64_MAX);
  assert(fits);
  eval->job.part_bytes = eval->layout.payload_bytes;
  return JOB_NEXT_PART;
}

/* What a profile with a table, or a ruler, is charged for in radii: looking transport up takes up to a
 * millisecond if the cache does not have it, so that few channels share a turn. */
enum { PREPARED_RADII = JOB_SLICE_RADII / 4 };

static enum job_outcome step_eval(struct job *job, uint64_t *budget) {
  struct eval_job *eval = eval_of(job);
  size_t n;
  double cost = 1, fixed = 0;
  uint64_t prepared = 0;
  if (!eval->radii_done) {
    cost += grid_cost(eval);
    n = slice_length(eval, fixed, cost);
    radii_step(eval, n);
  } else {
    const bool gets = !eval->lookup.ready;
    const enum job_outcome outcome = gets ? get_profile(eval) : JOB_GOES_ON;
    if (outcome != JOB_GOES_ON || !eval->lookup.ready) {
      return outcome;
    }
    const bool has_table = eval->ruler.ready || eval->lookup.profile.table != NULL;
    prepared = gets && has_table ? PREPARED_RADII : 0;
    cost = cost_of(eval);
    fixed = core_call_cost(&eval->lookup.profile, eval->request.fixed.wanted);
    n = slice_length(eval, fixed, cost);
    channel_step(eval, n);
  }
  const uint64_t spent = (uint64_t)((double)n * cost + fixed) + prepared + JOB_STEP_RADII;
  *budget -= spent < *budget ? spent : *budget;
  if (eval->channel < eval->request.fixed.medium_count) {
    return JOB_GOES_ON;
  }
  const wire_error error = choice_refusal(&eval->choice, &eval->request);
  if (error.status != WIRE_STATUS_OK) {
    /* Passes that still hold values for the reply must not write them into freed memory. */
    batch_finish(&eval->job.context->batch, stats_of(eval));
    return job_refuse(&eval->job, error);
  }
  return end_part(eval);
}

void eval_job_end(struct job *job) {
  struct eval_job *eval = eval_of(job);
  if (eval->repeated == NULL) {
    free(eval->head);
    profiles_return(&eval->lookup);
    profiles_return(&eval->ruler);
  }
}

const struct job_kind job_kind_EVAL = {
    .start = start_eval, .begin_part = begin_eval_part, .step = step_eval, .end = eval_job_end};

const struct job_kind job_kind_SAMPLE = {
    .start = start_sample, .begin_part = begin_eval_part, .step = step_eval, .end = eval_job_end};
