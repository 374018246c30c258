#include "clients/c/parts.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "clients/c/error.h"

/* The largest size of the first structure of a reply in parts. */
enum { START_MAX_BYTES = 256 };

libdipole_frame *libdipole_frame_new(const wire_header *header, uint64_t payload_bytes,
                                     uint32_t channel_count, dipole_error *error) {
  const uint64_t beside =
      sizeof(libdipole_frame) + channel_count * (uint64_t)sizeof(dipole_channel);
  libdipole_frame *frame =
      payload_bytes <= SIZE_MAX - beside ? malloc((size_t)(payload_bytes + beside)) : NULL;
  if (frame == NULL) {
    libdipole_fail(error, DIPOLE_ERROR_MEMORY, "out of memory: %llu bytes for a reply",
                   (unsigned long long)payload_bytes);
    return NULL;
  }
  frame->header = *header;
  frame->payload_bytes = payload_bytes;
  return frame;
}

bool libdipole_part_is_next(const libdipole_pending *pending, const wire_part *part) {
  const uint64_t left = pending->radius_count - pending->next_radius;
  const bool is_last = part->part + 1 == part->part_count;
  return part->part < part->part_count && part->part == pending->next_part &&
         part->first == pending->next_radius && part->count <= left &&
         is_last == (part->count == left) &&
         (part->count > 0 || part->part_count == 1 || pending->type == WIRE_TYPE_GATHER) &&
         (pending->next_part == 0 || part->part_count == pending->part_count);
}

void libdipole_parts_drop(libdipole_pending *pending) {
  free(pending->gathered);
  pending->gathered = NULL;
  pending->next_part = 0;
  pending->next_radius = 0;
}

/* Computes the layout of the whole reply, whose structure begins as that of a part. */
static bool lay_out_whole(const libdipole_pending *pending, const libdipole_frame *part,
                          schema_layout *layout) {
  const schema_payload *reply = pending->kind->reply;
  const wire_part whole = {.part_count = 1, .count = pending->radius_count};
  _Alignas(8) uint8_t start[START_MAX_BYTES];
  memcpy(start, part->payload, reply->fixed_bytes);
  wire_put_part(start, &whole);
  return schema_lay_out(reply, start, SIZE_MAX, layout, NULL);
}

/* Allocates the frame of the whole reply. If the arrays go elsewhere, it holds only the head. */
static bool begin_whole(libdipole_pending *pending, const libdipole_frame *first,
                        const schema_layout *whole, bool only_head, dipole_error *error) {
  const uint64_t bytes = only_head ? pending->reply_bytes_min : whole->payload_bytes;
  pending->gathered = libdipole_frame_new(&first->header, bytes, pending->medium_count, error);
  if (pending->gathered != NULL) {
    memcpy(pending->gathered->payload, first->payload,
           only_head ? pending->reply_bytes_min : pending->kind->reply->fixed_bytes);
  }
  return pending->gathered != NULL;
}

/* Copies the arrays of a part to their places in the whole reply. Arrays without an element for
 * each item are the same in all parts, or only those of the last part count. */
static void copy_arrays(const libdipole_pending *pending, const schema_layout *to,
                        const libdipole_frame *part, const schema_layout *from) {
  const schema_part *parts = pending->kind->reply->parts;
  wire_part fixed;
  wire_get_part(part->payload, &fixed);
  for (unsigned i = 0; parts[i].name != NULL; i++) {
    const uint64_t count = from->parts[i].count, stride = from->parts[i].array_bytes;
    if (count == 0) {
      continue;
    }
    const uint64_t end = parts[i + 1].name != NULL ? from->parts[i + 1].at : from->payload_bytes;
    const uint64_t before = count == to->parts[i].count ? 0 : count / fixed.count * fixed.first;
    uint8_t *at = pending->gathered->payload + to->parts[i].at + before * from->parts[i].bytes;
    for (uint64_t array = from->parts[i].at; array < end; array += stride) {
      memcpy(at, part->payload + array, (size_t)(count * from->parts[i].bytes));
      at += to->parts[i].array_bytes;
    }
  }
}

/* Adds a checked part to the reply, and owns its frame. *whole: whether the reply is complete. */
static bool add_part(libdipole_pending *pending, libdipole_frame *frame, const wire_part *part,
                     const schema_layout *layout, dipole_error *error) {
  const bool only_head = pending->reader != NULL;
  schema_layout whole;
  if (!lay_out_whole(pending, frame, &whole)) {
    return libdipole_fail_memory(error);
  }
  if (pending->gathered == NULL && !begin_whole(pending, frame, &whole, only_head, error)) {
    return false;
  }
  if (!only_head) {
    copy_arrays(pending, &whole, frame, layout);
  } else if (!pending->dropped) {
    pending->kind->hand_on(pending, frame);
  }
  pending->part_count = part->part_count;
  pending->next_part++;
  pending->next_radius += part->count;
  if (pending->next_part == part->part_count) {
    const wire_part all = {.part_count = 1, .count = pending->radius_count};
    wire_put_part(pending->gathered->payload, &all);
    pending->frame = pending->gathered;
    pending->gathered = NULL;
    libdipole_parts_drop(pending);
  }
  return true;
}

bool libdipole_part_take(libdipole_pending *pending, libdipole_frame *frame, dipole_error *error) {
  const libdipole_kind *kind = pending->kind;
  void *before = pending->gathered != NULL ? pending->gathered->payload : NULL;
  schema_layout layout;
  wire_part part;
  wire_get_part(frame->payload, &part);
  const bool only = part.part_count == 1 && before == NULL && pending->reader == NULL;
  if (only && kind->checked_later) {
    pending->frame = frame;
    return true;
  }
  bool good = schema_is_whole(kind->reply, frame->payload, frame->payload_bytes, &layout) &&
              libdipole_part_is_next(pending, &part) &&
              kind->merge(pending, frame->payload, before);
  if (good && only) {
    pending->frame = frame;
    return true;
  }
  if (good) {
    good = add_part(pending, frame, &part, &layout, error);
  } else {
    char what[96];
    snprintf(what, sizeof what,
             "it replied to a request of type %s with another shape than requested",
             wire_type_name(pending->type));
    libdipole_fail_protocol(error, what);
  }
  free(frame);
  return good;
}

/* ---- results: each is the first member of its frame, so this frees the whole frame -------------- */

#define FREE_WITH_FRAME(type)                                                                      \
  void type##_free(type *result) {                                                                 \
    free(result);                                                                                  \
  }
FREE_WITH_FRAME(dipole_result)
FREE_WITH_FRAME(dipole_inversion)
FREE_WITH_FRAME(dipole_fits)
FREE_WITH_FRAME(dipole_layers_fit)
FREE_WITH_FRAME(dipole_tissue_fits)
FREE_WITH_FRAME(dipole_varying_result)
FREE_WITH_FRAME(dipole_mc_result)
FREE_WITH_FRAME(dipole_reply)
