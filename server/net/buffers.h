/* buffers: the bytes of one connection between its socket and its requests.
 *
 * The input holds bytes that have arrived and have not been dealt with, as frames. Payloads are
 * used in place. The output holds replies that wait to be written, in chunks. Kernels write their
 * results into a chunk and the socket reads them from there, so nothing is copied. Small replies
 * share a chunk; a large one has its own. The input and the output count against a budget of
 * bytes: the server's, unless the owner sets another one before it uses them.
 */
#ifndef DIPOLED_BUFFERS_H
#define DIPOLED_BUFFERS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "proto/wire.h"
#include "server/server.h"

/* ---- input ----------------------------------------------------------------------------------- */

/* At time `ns`, the first `total_bytes` bytes of the connection had arrived. */
struct input_mark {
  uint64_t total_bytes;
  uint64_t ns;
};

enum { INPUT_MARKS = 16 };

struct input {
  struct server *server;
  struct budget *budget;
  uint8_t *bytes;
  size_t capacity;
  size_t begin;         /* where the first frame begins that has not been dealt with */
  size_t end;           /* end of the bytes that have arrived */
  uint64_t skip_bytes;  /* bytes of a refused payload that have still to arrive */
  uint64_t skip_id;     /* request id of the refused payload */
  uint64_t total_bytes; /* number of bytes that have arrived so far */
  struct input_mark
      *marks; /* [INPUT_MARKS] times of the bytes in the buffer, in order; NULL without */
  unsigned mark_count;
};

enum input_outcome {
  INPUT_INCOMPLETE, /* no complete frame has arrived */
  INPUT_FRAME,      /* a complete and well-formed frame has arrived */
  INPUT_REFUSED,    /* the header of a frame is wrong; input_next() skips its payload */
  INPUT_LOST,       /* the bytes are no frame; where the next frame begins is unknown */
};

void input_init(struct input *input, struct server *server);
void input_free(struct input *input);

/* Sets *room to the memory for the next bytes and returns how many fit; 0 if the memory budget is
 * exhausted. May move the buffer, so no payload may be in use. */
size_t input_room(struct input *input, uint8_t **room);

/* Sets *room to the free memory behind the bytes that have arrived, and returns how many bytes fit.
 * Moves nothing, so payloads may be in use. Returns 0 if there is no such memory. */
size_t input_room_behind(struct input *input, uint8_t **room);

/* Notes that this many bytes have been read into the room, at time now_ns. */
void input_arrived(struct input *input, size_t bytes, uint64_t now_ns);

/* Returns when the last byte of the first frame arrived. The time may be too early when many frames
 * wait, but never too late. */
uint64_t input_arrival_ns(const struct input *input, const wire_header *header);

/* Looks at the first frame and sets *header unless it is INCOMPLETE. With FRAME, *payload is
 * aligned to 8 and stays valid until input_next(). With REFUSED and LOST, *error says why. */
enum input_outcome input_frame(struct input *input, wire_header *header, const uint8_t **payload,
                               wire_error *error);

/* Removes the first frame, for which input_frame() returned INPUT_FRAME or INPUT_REFUSED. */
void input_next(struct input *input, const wire_header *header);

/* The memory of a frame that has been taken out of the input. */
struct input_block {
  uint8_t *bytes; /* NULL: none */
  size_t capacity;
  const uint8_t *payload; /* aligned to 8 */
};

/* Removes the first frame, for which input_frame() returned INPUT_FRAME, but keeps its payload in a
 * block, which the caller frees with input_free_block(). A large frame that fills most of the buffer
 * takes it along and is not copied. Returns false, and changes nothing, if there is no memory. */
bool input_take(struct input *input, const wire_header *header, struct input_block *block);
void input_free_block(struct input *input, struct input_block *block);

/* Skips an incomplete frame for which there is no memory. Returns false if not even its header has
 * arrived. */
bool input_refuse(struct input *input, wire_header *header);

/* Frees the buffer if it is empty. */
void input_release(struct input *input);

/* Shrinks the buffer to its first size if that is enough for what has arrived. Call this several times
 * a second, while no payload is in use. */
void input_trim(struct input *input);

/* Returns whether a frame has begun to arrive and is not complete. */
bool input_partial(const struct input *input);

/* Returns the request id of this frame, which may have been refused already; 0 if its header is not
 * complete. */
uint64_t input_partial_id(const struct input *input);

/* ---- output ---------------------------------------------------------------------------------- */

struct output_chunk;

struct output {
  struct server *server;
  struct budget *budget;
  struct output_chunk *first;
  struct output_chunk *last;
  uint64_t ready_bytes;  /* number of bytes that are committed and not yet consumed */
  size_t reserved_bytes; /* size of the reservation at the end of the last chunk */
};

void output_init(struct output *output, struct server *server);
void output_free(struct output *output);

/* Frees all memory if nothing waits to be written. */
void output_release(struct output *output);

/* Returns whether more than --max-queued-bytes wait to be written, so that further requests wait.
 */
static inline bool output_is_full(const struct output *output) {
  return output->ready_bytes > output->server->options.max_queued_bytes;
}

/* Reserves bytes (a multiple of 8) at an address that is a multiple of 8 and stays valid until the
 * bytes have been consumed. Returns NULL if the memory budget is exhausted. There may be one
 * reservation at a time. */
uint8_t *output_reserve(struct output *output, size_t bytes);

/* Commits the reserved bytes: they are complete and may be written to the socket. */
void output_commit(struct output *output);

/* Gives up the reservation. */
void output_cancel(struct output *output);

/* Sets up to count buffers to the first committed bytes. Returns how many it has set. */
size_t output_buffers(struct output *output, uv_buf_t *buffers, size_t count);

/* Removes the first bytes, which have been written. */
void output_consume(struct output *output, uint64_t bytes);

#endif
