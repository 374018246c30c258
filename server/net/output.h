/* output: the answers of one connection that wait to be written, in chunks.
 *
 * Kernels write their results into a chunk, and the socket takes them from there: nothing is
 * copied. Small answers share a chunk; a large one gets its own. Memory is taken from the server's
 * budget.
 */
#ifndef DIPOLED_OUTPUT_H
#define DIPOLED_OUTPUT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "server/server.h"

struct output_chunk;

struct output {
  struct server *server;
  struct output_chunk *first;
  struct output_chunk *last;
  struct output_chunk *spares; /* that have been written, for the next answers */
  size_t spare_bytes;
  bool spares_used;      /* since output_settle() */
  uint64_t spares_ms;    /* when output_settle() last found so */
  uint64_t ready_bytes;  /* committed and not yet consumed */
  size_t reserved_bytes; /* at the end of the last chunk, being filled */
};

void output_init(struct output *output, struct server *server);
void output_free(struct output *output);

/* Gives its memory back when nothing waits. */
void output_rest(struct output *output);

/* From time to time: gives the spares back when none has been used for a while. */
void output_settle(struct output *output, uint64_t now_ms);

/* Whether the reader does not keep up (--max-queued-bytes), so that its requests wait. */
static inline bool output_is_full(const struct output *output) {
  return output->ready_bytes > output->server->options.max_queued_bytes;
}

/* Room for bytes (a multiple of 8) at an address that is a multiple of 8, stable until it has been
 * consumed; NULL: the memory budget is exhausted. One reservation at a time. */
uint8_t *output_reserve(struct output *output, size_t bytes);

/* The reserved bytes are complete and may be written. */
void output_commit(struct output *output);

/* Gives up what was reserved. */
void output_cancel(struct output *output);

/* Up to count buffers that cover committed bytes from the front; their number. */
size_t output_buffers(struct output *output, uv_buf_t *buffers, size_t count);

/* bytes from the front have been written. */
void output_consume(struct output *output, uint64_t bytes);

#endif
