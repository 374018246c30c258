/* output: the answers of one connection that wait to be written, in chunks.
 *
 * Kernels write their results into a chunk and the socket reads them from there, so answers are not
 * copied. Small answers share a chunk; a large one has its own. Chunks count against the server's
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
  struct output_chunk *spares; /* chunks that have been written, kept for the next answers */
  size_t spare_bytes;
  bool spares_used;      /* since output_trim() */
  uint64_t spares_ms;    /* when output_trim() last found spares_used set */
  uint64_t ready_bytes;  /* committed and not yet consumed */
  size_t reserved_bytes; /* the reservation at the end of the last chunk */
};

void output_init(struct output *output, struct server *server);
void output_free(struct output *output);

/* Frees all memory if nothing waits to be written. */
void output_release(struct output *output);

/* Frees the spares when none has been used for a second. Call this several times a second. */
void output_trim(struct output *output, uint64_t now_ms);

/* Whether the reader does not keep up (--max-queued-bytes), so that its requests wait. */
static inline bool output_is_full(const struct output *output) {
  return output->ready_bytes > output->server->options.max_queued_bytes;
}

/* Reserves bytes (a multiple of 8) at an address that is a multiple of 8 and stays valid until the
 * bytes have been consumed. Returns NULL if the memory budget is exhausted. There may be one
 * reservation at a time. */
uint8_t *output_reserve(struct output *output, size_t bytes);

/* The reserved bytes are complete and may be written. */
void output_commit(struct output *output);

/* Gives up the reservation. */
void output_cancel(struct output *output);

/* Sets up to count buffers to the first committed bytes. Returns how many it has set. */
size_t output_buffers(struct output *output, uv_buf_t *buffers, size_t count);

/* Removes the first bytes, which have been written. */
void output_consume(struct output *output, uint64_t bytes);

#endif
