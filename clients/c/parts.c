/* An answer that comes in several frames, its parts: each is checked, and then either copied to its
 * place in the whole answer or handed on as a result of its own. */
#include <stdlib.h>
#include <string.h>

#include "clients/c/client.h"

bool libdipole_part_is(const libdipole_pending *pending, const libdipole_frame *frame) {
  wire_eval_reply fixed;
  const bool is_invert = pending->type == WIRE_TYPE_INVERT;
  if ((!is_invert && pending->type != WIRE_TYPE_EVAL && pending->type != WIRE_TYPE_SAMPLE) ||
      frame->header.type == WIRE_TYPE_ERROR) {
    return false;
  }
  if (is_invert || pending->gathered != NULL || pending->reader != NULL) {
    return true;
  }
  wire_get_eval_reply(frame->payload, &fixed); /* no shorter: see check_header() */
  return fixed.part_count != 1;
}

/* Fixed part and channels: what all parts say alike. */
static size_t head_bytes(const libdipole_pending *pending) {
  return WIRE_BYTES_eval_reply + (size_t)pending->medium_count * WIRE_BYTES_channel;
}

/* The parts of an answer differ in their radii and values, and in nothing else. */
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

/* Whether the arrays went where the caller wants them: nothing but the head is in the frame. */
static bool is_in_place(const libdipole_frame *part) {
  return part->stored_bytes < part->payload_bytes;
}

/* Room for the whole answer, or for its beginning when the parts are handed on. */
static bool begin(libdipole_pending *pending, const libdipole_frame *first,
                  const wire_eval_reply *fixed, dipole_error *error) {
  const size_t head = head_bytes(pending);
  eval_layout layout = {.payload_bytes = head};
  /* It has been laid out before it was asked for: what has no layout gets no answer. */
  if (pending->reader == NULL &&
      !eval_reply_layout(fixed->evaluator, libdipole_wanted(pending->type, fixed->wanted),
                         fixed->channel_count, pending->radius_count, UINT64_MAX, &layout)) {
    return libdipole_fail(error, DIPOLE_ERROR_MEMORY, "out of memory");
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

/* Of one array: what the part holds of it, into its place. */
static void copy_array(libdipole_frame *to, uint64_t to_offset, const libdipole_frame *part,
                       uint64_t part_offset, const wire_eval_reply *fixed) {
  const size_t value_bytes = core_evaluator_bytes(fixed->evaluator);
  memcpy(to->payload + to_offset + fixed->radius_first * value_bytes, part->payload + part_offset,
         (size_t)fixed->radius_count * value_bytes);
}

static void copy_part(const libdipole_pending *pending, const libdipole_frame *part,
                      const wire_eval_reply *fixed, const eval_layout *from) {
  const unsigned wanted = libdipole_wanted(pending->type, fixed->wanted);
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
  const dipole_result *result = libdipole_result_make(part, fixed, layout);
  reader->stopped = !reader->part(reader->context, result, fixed->radius_first);
  pending->dropped = reader->stopped && fixed->part + 1 < fixed->part_count;
}

/* What was gathered is a whole answer from now on, and no part of one. */
static void finish(libdipole_pending *pending, wire_eval_reply fixed) {
  fixed.radius_count = pending->radius_count;
  fixed.radius_first = 0;
  fixed.part = 0;
  fixed.part_count = 1;
  wire_put_eval_reply(pending->gathered->payload, &fixed);
  pending->frame = pending->gathered;
  pending->gathered = NULL;
  pending->next_part = 0;
  pending->next_radius = 0;
}

static bool take(libdipole_pending *pending, libdipole_frame *part, dipole_error *error) {
  wire_eval_reply fixed;
  eval_layout layout;
  if (!libdipole_answer_parse(pending, part, &fixed, &layout, error)) {
    return false;
  }
  if (pending->gathered == NULL) {
    if (!begin(pending, part, &fixed, error)) {
      return false;
    }
  } else if (!is_like_first(pending, part, &fixed)) {
    return libdipole_fail(error, DIPOLE_ERROR_PROTOCOL,
                          "the peer does not speak this protocol: the parts of its answer do not "
                          "belong together");
  }
  pending->next_part++;
  pending->next_radius += fixed.radius_count;
  if (pending->reader == NULL && !is_in_place(part)) {
    copy_part(pending, part, &fixed, &layout);
  } else if (pending->reader != NULL && !pending->dropped) {
    hand_on(pending, part, &fixed, &layout);
  }
  if (fixed.part + 1 == fixed.part_count) {
    finish(pending, fixed);
  }
  return true;
}

bool libdipole_part_take(libdipole_pending *pending, libdipole_frame *frame, dipole_error *error) {
  const bool good = pending->type == WIRE_TYPE_INVERT ? libdipole_media_take(pending, frame, error)
                                                      : take(pending, frame, error);
  free(frame);
  return good;
}
