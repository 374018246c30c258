#include "clients/c/answer.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"

/* Returns the wanted quantities as proto/eval.h takes them: with a flag for a sample's radii. */
static unsigned wanted_of(uint16_t type, unsigned wanted) {
  return (type & ~WIRE_REPLY) == WIRE_TYPE_SAMPLE ? wanted | EVAL_DRAWN : wanted;
}

void libdipole_answer_expect(libdipole_pending *pending, unsigned model, unsigned evaluator,
                             unsigned wanted, uint32_t medium_count, uint64_t radius_count) {
  const bool drawn = pending->type == WIRE_TYPE_SAMPLE;
  eval_layout layout;
  pending->model = model;
  pending->evaluator = (uint16_t)evaluator;
  pending->wanted = (uint16_t)wanted;
  pending->medium_count = medium_count;
  pending->radius_count = radius_count;
  pending->reply_bytes_min = UINT64_MAX;
  if (core_evaluator_bytes(evaluator) > 0 &&
      eval_reply_layout(evaluator, wanted_of(pending->type, wanted), medium_count, radius_count,
                        UINT64_MAX, &layout)) {
    pending->reply_bytes_min = drawn ? layout.arrays_offset : layout.radius_offset;
    pending->reply_bytes_max = layout.payload_bytes;
  }
}

/* ---- checks -------------------------------------------------------------------------------- */

/* Returns whether a reply has the model and the evaluator of the request. With DIPOLE_ANY_MODEL the
 * daemon chooses both, but not the type of the values. */
static bool is_asked_for(const libdipole_pending *pending, const wire_eval_reply *fixed) {
  return pending->model == DIPOLE_ANY_MODEL
             ? core_evaluator_bytes(fixed->evaluator) == core_evaluator_bytes(pending->evaluator)
             : fixed->evaluator == pending->evaluator;
}

/* Returns whether a part starts where the part before it ended, and has a valid number of radii. An
 * answer in one frame is one part. */
static bool is_next_part(const libdipole_pending *pending, const wire_eval_reply *fixed) {
  const uint64_t left = pending->radius_count - pending->next_radius;
  const bool is_last = fixed->part + 1 == fixed->part_count;
  return fixed->part == pending->next_part && fixed->first == pending->next_radius &&
         fixed->count <= left && is_last == (fixed->count == left) &&
         (fixed->count > 0 || fixed->part_count == 1);
}

/* Checks that a frame is the next part of the answer and has the counts of the request, so that a
 * caller who indexes the arrays by these counts stays inside. */
static bool parse(const libdipole_pending *pending, const libdipole_frame *frame,
                  wire_eval_reply *fixed, eval_layout *layout, dipole_error *error) {
  return (eval_reply_parse(frame->payload, (size_t)frame->payload_bytes,
                           pending->type == WIRE_TYPE_SAMPLE, fixed, layout) &&
          is_asked_for(pending, fixed) && fixed->wanted == pending->wanted &&
          fixed->channel_count == pending->medium_count && is_next_part(pending, fixed)) ||
         libdipole_fail_protocol(error, "it answered an eval request with another shape than was "
                                        "asked for");
}

/* ---- results ------------------------------------------------------------------------------- */

/* Returns the array of a quantity, or NULL if there is none. In the caller's memory (into_values)
 * the arrays lie one behind the other without padding, and the radii are not among them. */
static const void *array_at(const libdipole_frame *frame, const eval_layout *layout,
                            unsigned wanted, uint64_t values_bytes, uint32_t channel,
                            enum core_quantity quantity) {
  if ((wanted & quantity) == 0) {
    return NULL;
  }
  const uint64_t offset = eval_array_offset(layout, wanted, channel, quantity);
  if (frame->into_values == NULL) {
    return frame->payload + offset;
  }
  const uint64_t before =
      layout->array_bytes > 0 ? (offset - layout->arrays_offset) / layout->array_bytes : 0;
  return (const uint8_t *)frame->into_values + before * values_bytes;
}

static void get_channel(const libdipole_frame *frame, const eval_layout *layout,
                        const wire_eval_reply *fixed, uint32_t index, dipole_channel *channel) {
  const unsigned wanted = wanted_of(frame->header.type, fixed->wanted);
  const wire_quantity_error most = eval_largest_error(frame->payload, layout, wanted, index);
  *channel = (dipole_channel){.numerical_error = most.numerical_error,
                              .numerical_error_per_mm = most.numerical_error_per_mm,
                              .model_error = most.model_error};
  memcpy(&channel->albedo, frame->payload + eval_albedo_offset(index), sizeof channel->albedo);
  const uint64_t bytes = fixed->count * core_evaluator_bytes(fixed->evaluator);
  const void *R = array_at(frame, layout, wanted, bytes, index, CORE_QUANTITY_R);
  const void *cdf = array_at(frame, layout, wanted, bytes, index, CORE_QUANTITY_CDF);
  if (fixed->evaluator == DIPOLE_F64) {
    channel->R_f64 = R;
    channel->cdf_f64 = cdf;
  } else {
    channel->R_f32 = R;
    channel->cdf_f32 = cdf;
  }
}

/* Fills in frame->result, whose arrays are those in the payload of the frame. */
static dipole_result *make_result(libdipole_frame *frame, const wire_eval_reply *fixed,
                                  const eval_layout *layout) {
  const unsigned wanted = wanted_of(frame->header.type, fixed->wanted);
  const void *radii = frame->into_radii;
  dipole_channel *channels = (dipole_channel *)(void *)(frame->payload + frame->stored_bytes);
  if ((wanted & CORE_QUANTITY_RADIUS) == 0 || eval_is_array(wanted, CORE_QUANTITY_RADIUS)) {
    radii = NULL;
  } else if (radii == NULL) {
    radii = frame->payload + layout->radius_offset;
  }
  for (uint32_t i = 0; i < fixed->channel_count; i++) {
    get_channel(frame, layout, fixed, i, &channels[i]);
  }
  frame->result = (dipole_result){.model = fixed->model,
                                  .evaluator = fixed->evaluator,
                                  .moments = fixed->moments,
                                  .wanted = fixed->wanted,
                                  .notes = fixed->notes,
                                  .radius_count = fixed->count,
                                  .radius_f64 = fixed->evaluator == DIPOLE_F64 ? radii : NULL,
                                  .radius_f32 = fixed->evaluator == DIPOLE_F64 ? NULL : radii,
                                  .channel_count = fixed->channel_count,
                                  .channels = channels};
  return &frame->result;
}

bool libdipole_result_take(dipole_client *client, libdipole_pending *pending,
                           dipole_result **result, dipole_error *error) {
  libdipole_frame *frame = pending->frame;
  wire_eval_reply fixed;
  eval_layout layout;
  if (!libdipole_refusal_check(client, pending, error)) {
    free(frame);
    return false;
  }
  if (!parse(pending, frame, &fixed, &layout, error)) {
    client->broken = *error;
    free(frame);
    return false;
  }
  frame->into_values = pending->into_values;
  frame->into_radii = pending->into_radii;
  *result = make_result(frame, &fixed, &layout);
  return true;
}

/* Returns the array of a quantity; NULL if there is none or its values have another size. Computes
 * the layout again from the counts of the result. */
static const void *values(const dipole_result *result, uint32_t channel, unsigned quantity,
                          size_t value_bytes) {
  const libdipole_frame *frame = (const libdipole_frame *)(const void *)result;
  const unsigned wanted = wanted_of(frame->header.type, result->wanted);
  eval_layout layout;
  if (core_evaluator_bytes(result->evaluator) != value_bytes || channel >= result->channel_count ||
      !eval_is_array(wanted, quantity) ||
      !eval_reply_layout(result->evaluator, wanted, result->channel_count, result->radius_count,
                         frame->payload_bytes, &layout)) {
    return NULL;
  }
  return array_at(frame, &layout, wanted, result->radius_count * value_bytes, channel, quantity);
}

const double *dipole_values_f64(const dipole_result *result, uint32_t channel, unsigned quantity) {
  return values(result, channel, quantity, sizeof(double));
}

const float *dipole_values_f32(const dipole_result *result, uint32_t channel, unsigned quantity) {
  return values(result, channel, quantity, sizeof(float));
}

dipole_errors dipole_errors_of(const dipole_result *result, uint32_t channel, unsigned quantity) {
  const libdipole_frame *frame = (const libdipole_frame *)(const void *)result;
  const unsigned wanted = wanted_of(frame->header.type, result->wanted);
  eval_layout layout;
  wire_quantity_error error = {(double)NAN, (double)NAN, (double)NAN};
  if (channel < result->channel_count && (result->wanted & quantity) != 0 &&
      (quantity & (quantity - 1)) == 0 &&
      eval_reply_layout(result->evaluator, wanted, result->channel_count, result->radius_count,
                        frame->payload_bytes, &layout)) {
    wire_get_quantity_error(frame->payload + eval_error_offset(&layout, wanted, channel, quantity),
                            &error);
  }
  return (dipole_errors){error.numerical_error, error.numerical_error_per_mm, error.model_error};
}

void dipole_result_free(dipole_result *result) {
  free(result); /* The result is the first member of the frame, so this frees the whole frame. */
}

/* ---- parts --------------------------------------------------------------------------------- */

/* Returns the size of an answer's head: the fixed part and the channels. All parts have this head.
 */
static size_t head_bytes(const libdipole_pending *pending) {
  const size_t errors = (size_t)__builtin_popcount(pending->wanted);
  return WIRE_BYTES_eval_reply +
         pending->medium_count * (sizeof(double) + errors * WIRE_BYTES_quantity_error);
}

/* Returns whether a part differs from the first one only in its radii and values. */
static bool is_like_first(const libdipole_pending *pending, const libdipole_frame *frame,
                          const wire_eval_reply *fixed) {
  const libdipole_frame *gathered = pending->gathered;
  wire_eval_reply first;
  wire_get_eval_reply(gathered->payload, &first);
  return fixed->model == first.model && fixed->evaluator == first.evaluator &&
         fixed->moments == first.moments && fixed->notes == first.notes &&
         fixed->part_count == first.part_count &&
         memcmp(frame->payload + WIRE_BYTES_eval_reply, gathered->payload + WIRE_BYTES_eval_reply,
                head_bytes(pending) - WIRE_BYTES_eval_reply) == 0;
}

/* Returns whether the arrays of a part went into the caller's memory, so that the frame holds only
 * the head. */
static bool is_in_place(const libdipole_frame *part) {
  return part->stored_bytes < part->payload_bytes;
}

/* Allocates the frame of the whole answer. If a reader gets the parts, it only holds the head. */
static bool begin_gathering(libdipole_pending *pending, const libdipole_frame *first,
                            const wire_eval_reply *fixed, dipole_error *error) {
  const size_t head = head_bytes(pending);
  eval_layout layout = {.payload_bytes = head};
  /* Without a layout, the answer would not have passed check_header(). */
  if (pending->reader == NULL &&
      !eval_reply_layout(fixed->evaluator, wanted_of(pending->type, fixed->wanted),
                         fixed->channel_count, pending->radius_count, UINT64_MAX, &layout)) {
    return libdipole_fail_memory(error);
  }
  pending->gathered = libdipole_frame_new(&first->header, layout.payload_bytes,
                                          is_in_place(first) ? head : layout.payload_bytes,
                                          pending->medium_count, error);
  if (pending->gathered == NULL) {
    return false;
  }
  memcpy(pending->gathered->payload, first->payload, head);
  return true;
}

/* Copies the values that a part has for one array to their place in the whole answer. */
static void copy_array(libdipole_frame *to, uint64_t to_offset, const libdipole_frame *part,
                       uint64_t part_offset, const wire_eval_reply *fixed) {
  const size_t value_bytes = core_evaluator_bytes(fixed->evaluator);
  memcpy(to->payload + to_offset + fixed->first * value_bytes, part->payload + part_offset,
         (size_t)fixed->count * value_bytes);
}

static void copy_part(const libdipole_pending *pending, const libdipole_frame *part,
                      const wire_eval_reply *fixed, const eval_layout *from) {
  const unsigned wanted = wanted_of(pending->type, fixed->wanted);
  libdipole_frame *whole = pending->gathered;
  eval_layout to;
  eval_reply_layout(fixed->evaluator, wanted, fixed->channel_count, pending->radius_count,
                    whole->payload_bytes, &to);
  if ((wanted & CORE_QUANTITY_RADIUS) != 0 && !eval_is_array(wanted, CORE_QUANTITY_RADIUS)) {
    copy_array(whole, to.radius_offset, part, from->radius_offset, fixed);
  }
  for (uint32_t channel = 0; channel < fixed->channel_count; channel++) {
    for (const core_choice *quantity = core_quantities; quantity->name != NULL; quantity++) {
      if (eval_is_array(wanted, quantity->id)) {
        copy_array(whole, eval_array_offset(&to, wanted, channel, quantity->id), part,
                   eval_array_offset(from, wanted, channel, quantity->id), fixed);
      }
    }
  }
}

static void hand_on(libdipole_pending *pending, libdipole_frame *part, const wire_eval_reply *fixed,
                    const eval_layout *layout) {
  libdipole_reader *reader = pending->reader;
  const dipole_result *result = make_result(part, fixed, layout);
  reader->stopped = !reader->part(reader->context, result, fixed->first);
  pending->dropped = reader->stopped && fixed->part + 1 < fixed->part_count;
}

static bool take_part(libdipole_pending *pending, libdipole_frame *part, dipole_error *error) {
  wire_eval_reply fixed;
  eval_layout layout;
  if (!parse(pending, part, &fixed, &layout, error)) {
    return false;
  }
  if (pending->gathered == NULL) {
    if (!begin_gathering(pending, part, &fixed, error)) {
      return false;
    }
  } else if (!is_like_first(pending, part, &fixed)) {
    return libdipole_fail_protocol(error, "the parts of its answer do not belong together");
  }
  if (pending->reader == NULL && !is_in_place(part)) {
    copy_part(pending, part, &fixed, &layout);
  } else if (pending->reader != NULL && !pending->dropped) {
    hand_on(pending, part, &fixed, &layout);
  }
  libdipole_part_end(pending, part);
  return true;
}

static bool take(libdipole_pending *pending, libdipole_frame *frame, dipole_error *error) {
  wire_eval_reply fixed;
  wire_get_eval_reply(frame->payload, &fixed); /* check_header() has seen that it is long enough. */
  if (pending->gathered == NULL && pending->reader == NULL && fixed.part_count == 1) {
    pending->frame = frame;
    return true;
  }
  const bool good = take_part(pending, frame, error);
  free(frame);
  return good;
}

const libdipole_kind libdipole_eval_kind = {.repeatable = true, .take = take};

/* ---- into the caller's memory -------------------------------------------------------------- */

/* Starts to receive arrays into the caller's memory: checks the head, which has arrived. */
static bool begin_placing(dipole_client *client, const libdipole_pending *pending,
                          dipole_error *error) {
  libdipole_into *into = &client->into;
  eval_layout layout;
  if (!parse(pending, client->frame, &into->fixed, &layout, error)) {
    return false;
  }
  const bool radii = (into->fixed.wanted & CORE_QUANTITY_RADIUS) != 0;
  into->begun = true;
  into->array_bytes = layout.array_bytes;
  into->array_count = layout.array_bytes > 0
                          ? radii + (uint64_t)into->fixed.channel_count * layout.arrays_per_channel
                          : 0;
  into->array = 0;
  into->done_bytes = 0;
  return true;
}

/* Returns the start, in the caller's memory, of the array that is being received. */
static uint8_t *array_start(const libdipole_into *into, const libdipole_pending *pending,
                            size_t value_bytes) {
  const bool radii = (into->fixed.wanted & CORE_QUANTITY_RADIUS) != 0;
  if (radii && into->array == 0) {
    return pending->into_radii;
  }
  return (uint8_t *)pending->into_values +
         (into->array - radii) * pending->radius_count * value_bytes;
}

/* Sets the memory that receives the next bytes. Returns false if the frame is complete. */
static bool place_bytes(dipole_client *client, const libdipole_pending *pending) {
  libdipole_into *into = &client->into;
  libdipole_stream *stream = &client->stream;
  if (into->array < into->array_count && into->done_bytes == into->array_bytes) {
    into->array++;
    into->done_bytes = 0;
  }
  if (into->array == into->array_count) {
    return false;
  }
  const size_t value_bytes = core_evaluator_bytes(into->fixed.evaluator);
  const uint64_t values_bytes =
      into->fixed.count * value_bytes; /* After the values, the array has only padding. */
  if (into->done_bytes < values_bytes && !pending->dropped) {
    stream->target = array_start(into, pending, value_bytes) + into->fixed.first * value_bytes +
                     into->done_bytes;
    stream->target_bytes = (size_t)(values_bytes - into->done_bytes);
  } else {
    const uint64_t left = into->array_bytes - into->done_bytes;
    stream->target = into->discarded;
    stream->target_bytes = left < sizeof into->discarded ? (size_t)left : sizeof into->discarded;
  }
  into->done_bytes += stream->target_bytes;
  return true;
}

static bool place(dipole_client *client, libdipole_pending *pending, bool *more,
                  dipole_error *error) {
  if (!client->into.begun && !begin_placing(client, pending, error)) {
    return false;
  }
  *more = place_bytes(client, pending);
  client->into.begun = *more;
  return true;
}

static void discard(dipole_client *client, libdipole_pending *pending) {
  if (client->into.begun) {
    client->into.done_bytes -= client->stream.target_bytes;
    place_bytes(client, pending);
  }
}

const libdipole_kind libdipole_eval_into_kind = {
    .repeatable = true, .take = take, .place = place, .discard = discard};
