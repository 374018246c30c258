/* input: the bytes of one connection that have arrived and are not yet dealt with, taken apart into
 * frames. Payloads are used where they lie. Memory is taken from the server's budget. */
#ifndef DIPOLED_INPUT_H
#define DIPOLED_INPUT_H

#include "proto/wire.h"
#include "server/server.h"

/* Up to which byte, counted from the first, what came had come at a time. */
struct input_mark {
  uint64_t total_bytes;
  uint64_t ns;
};

enum { INPUT_MARKS = 16 };

struct input {
  struct server *server;
  uint8_t *bytes;
  size_t capacity;
  size_t begin;                         /* of the first frame that has not been dealt with */
  size_t end;                           /* of what has arrived */
  bool large;                           /* it held as much as its first size, or nearly, */
  uint64_t large_ms;                    /* which input_settle() last found so then */
  uint64_t skip_bytes;                  /* of a refused payload, still to arrive */
  uint64_t total_bytes;                 /* that have arrived, ever */
  struct input_mark marks[INPUT_MARKS]; /* of what has not been dealt with, rising */
  unsigned mark_count;
};

enum input_outcome {
  INPUT_INCOMPLETE, /* no whole frame has arrived */
  INPUT_FRAME,      /* a frame, whole and well formed */
  INPUT_REFUSED,    /* a frame whose header is wrong; its payload is skipped */
  INPUT_LOST,       /* no frame at all: the framing is lost */
};

void input_init(struct input *input, struct server *server);
void input_free(struct input *input);

/* Where to read to, and how much may be read; 0: the memory budget is exhausted. Moves the bytes,
 * so no frame may be in use. */
size_t input_room(struct input *input, uint8_t **room);

/* bytes have been read to the room, at a time. */
void input_arrived(struct input *input, size_t bytes, uint64_t now_ns);

/* When the last byte of the frame that was looked at had arrived, or somewhat earlier. */
uint64_t input_arrival_ns(const struct input *input, const wire_header *header);

/* Looks at the first frame. FRAME: *payload is aligned to 8 and stays until input_next(). REFUSED
 * and LOST: *error says why. *header is the frame's in all cases but INCOMPLETE. */
enum input_outcome input_frame(struct input *input, wire_header *header, const uint8_t **payload,
                               wire_error *error);

/* The frame that was looked at has been dealt with; REFUSED or FRAME. */
void input_next(struct input *input, const wire_header *header);

/* The frame that has begun to arrive cannot be kept: skips it. False when not even its header is
 * there. */
bool input_refuse(struct input *input, wire_header *header);

/* Gives its memory back when nothing is held. */
void input_rest(struct input *input);

/* From time to time, while no frame is in use: gives back what it has grown by when it has not needed
 * that for a while. */
void input_settle(struct input *input, uint64_t now_ms);

/* Drops everything that has arrived. */
void input_discard(struct input *input);

/* True when a frame has begun and not ended. */
bool input_partial(const struct input *input);

#endif
