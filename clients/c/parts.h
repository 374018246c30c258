/* parts: requests that wait for their replies, and how the parts of a reply are put together. All
 * replies in parts begin with a wire_part; what follows is as messages.def says. */
#ifndef LIBDIPOLE_PARTS_H
#define LIBDIPOLE_PARTS_H

#include "clients/c/dipole.h"
#include "proto/schema.h"

/* ---- requests and replies ------------------------------------------------------------------ */

/* The reply to any message, whose payload is behind it in its frame. */
struct dipole_reply {
  const schema_payload *payload;
};

/* A received frame, or a reply that was put together of several frames. The caller's result is the
 * first member, so that freeing it frees the payload, too. Behind the payload there is room for the
 * channels of an eval. */
typedef struct libdipole_frame {
  union {
    dipole_result result;
    dipole_inversion inversion;
    dipole_fits fits;
    dipole_layers_fit layers_fit;
    dipole_tissue_fits tissue_fits;
    dipole_varying_result varying;
    dipole_mc_result mc;
    dipole_reply reply;
  };
  wire_header header;
  uint64_t payload_bytes; /* may be more than a header can say if the reply had several parts */
  _Alignas(8) uint8_t head[WIRE_BYTES_header]; /* see libdipole_frame_bytes() */
  _Alignas(8) uint8_t payload[];
} libdipole_frame;

/* Returns where the header has its place as on the wire: in front of the payload. */
static inline uint8_t *libdipole_frame_bytes(libdipole_frame *frame) {
  return (uint8_t *)frame + offsetof(libdipole_frame, head);
}

/* The caller's function that gets each part of a reply when it arrives. */
typedef struct libdipole_reader {
  bool (*part)(void *context, const dipole_result *part, uint64_t radius_first);
  void *context;
  bool stopped; /* The function returned false. */
} libdipole_reader;

typedef struct libdipole_pending libdipole_pending;

/* How the replies to one kind of request are read. A function may be NULL. */
typedef struct libdipole_kind {
  /* Every daemon gives the same reply to such a request, so the client may send it again. */
  bool repeatable;
  /* Whether the time limit of calls does not apply. */
  bool endless;
  /* The reply in parts: its arrays after the first structure. NULL: the reply is one frame. */
  const schema_payload *reply;
  /* Returns whether a part replies to the request, and belongs to `whole`: what has been merged from
   * the parts before it, or NULL. Both are structures of the reply. Merges the part. */
  bool (*merge)(const libdipole_pending *pending, const void *part, void *whole);
  /* Whether a reply of one part is checked later, by its caller, in place of here. */
  bool checked_later;
  /* Gives a part to pending->reader. */
  void (*hand_on)(libdipole_pending *pending, libdipole_frame *part);
  /* Returns whether this frame is a report of progress, which more frames follow. */
  bool (*is_progress)(const libdipole_frame *frame);
  /* Returns whether a daemon that stops cut this reply off: the client then requests it again. */
  bool (*is_cut_off)(const libdipole_frame *frame);
} libdipole_kind;

/* A repeatable request whose reply is one frame. */
extern const libdipole_kind libdipole_plain;

/* A request whose reply has not been handed out. The function that begins the request sets the
 * first group of fields, which say what the reply may look like. */
struct libdipole_pending {
  const libdipole_kind *kind;
  uint16_t type; /* enum wire_type */
  uint32_t deadline_ms;
  uint64_t reply_bytes_min, reply_bytes_max; /* range of a frame's payload */
  unsigned model;                            /* eval and sample; may be DIPOLE_ANY_MODEL */
  uint16_t evaluator;                        /* eval and sample */
  uint32_t wanted;                           /* likewise; invert: the kind of lengths */
  uint16_t moments;                          /* varying */
  uint16_t layer_count;                      /* layers of each medium; 0 means 1 */
  uint32_t medium_count; /* eval, sample: number of media; fit: residuals of each set; else 0 */
  /* number of items of the reply: radii (eval, sample), media (invert) or sets (fit) */
  uint64_t radius_count;
  libdipole_reader *reader; /* gets each part when it arrives; NULL: the parts are put together */
  void *into_values;        /* see dipole_query */
  void *into_radii;

  uint64_t id;
  libdipole_frame *frame; /* the reply; NULL if it is not complete yet */
  uint32_t next_part;     /* the number of the next part of the reply */
  uint32_t part_count;    /* the number of parts, from the first part */
  uint64_t next_radius;   /* number of radii, media or sets in the parts so far */
  /* The parts so far, as one reply. If there is a reader, this frame has no arrays. */
  libdipole_frame *gathered;
  bool dropped; /* The caller has dropped the request: do not use reader and into_*. */

  size_t frame_bytes;
  uint8_t *kept;     /* [frame_bytes] copy of the request; NULL: it cannot be sent again */
  int64_t sent_ms;   /* when the request was first sent, if it has a deadline */
  int64_t failed_ms; /* when the request first failed; 0 if it has not */
  int64_t again_ms;  /* when to send the request again; 0 if it has been sent */
};

/* ---- taking parts -------------------------------------------------------------------------------- */

/* Allocates a frame with this header, with room for a payload of payload_bytes and for channel_count
 * channels. Returns NULL if there is no memory. */
libdipole_frame *libdipole_frame_new(const wire_header *header, uint64_t payload_bytes,
                                     uint32_t channel_count, dipole_error *error);

/* Returns whether a frame is the next part of a reply, with a count that it may have. */
bool libdipole_part_is_next(const libdipole_pending *pending, const wire_part *part);

/* Takes a part of a reply, a frame, which it owns. After the last one, the whole reply is
 * pending->frame, as if it had come in one part. Fails with kind PROTOCOL if the part does not
 * belong to the request or to the parts before it. */
bool libdipole_part_take(libdipole_pending *pending, libdipole_frame *frame, dipole_error *error);

/* Throws away the parts of a reply that have come. */
void libdipole_parts_drop(libdipole_pending *pending);

#endif
