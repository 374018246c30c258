#include "server/net/output.h"

#include <assert.h>
#include <stdlib.h>

/* A chunk holds a few hundred small answers, which one system call then writes. */
enum { CHUNK_BYTES = 65536, SPARE_BYTES = 4194304, TRIM_MS = 1000 };

struct output_chunk {
  struct output_chunk *next;
  size_t capacity;
  size_t committed;
  size_t consumed;
  _Alignas(16) uint8_t bytes[];
};

void output_init(struct output *output, struct server *server) {
  *output = (struct output){.server = server};
}

static void free_chunk(struct output *output, struct output_chunk *chunk) {
  server_return_bytes(output->server, chunk->capacity);
  free(chunk);
}

/* Keeps the first chunk as a spare if SPARE_BYTES allow it: the system then does not have to map
 * its pages again. */
static void release_first(struct output *output) {
  struct output_chunk *chunk = output->first;
  output->first = chunk->next;
  if (output->first == NULL) {
    output->last = NULL;
  }
  if (chunk->capacity <= SPARE_BYTES - output->spare_bytes) {
    chunk->next = output->spares;
    output->spares = chunk;
    output->spare_bytes += chunk->capacity;
    output->spares_used = true;
  } else {
    free_chunk(output, chunk);
  }
}

static void free_spares(struct output *output) {
  while (output->spares != NULL) {
    struct output_chunk *chunk = output->spares;
    output->spares = chunk->next;
    free_chunk(output, chunk);
  }
  output->spare_bytes = 0;
}

void output_free(struct output *output) {
  while (output->first != NULL) {
    release_first(output);
  }
  free_spares(output);
}

void output_trim(struct output *output, uint64_t now_ms) {
  if (output->spares_used) {
    output->spares_ms = now_ms;
    output->spares_used = false;
  } else if (now_ms - output->spares_ms > TRIM_MS) {
    free_spares(output);
  }
}

/* Small answers do not get a large chunk, because it would be held longer than necessary. */
static bool is_fit(const struct output_chunk *chunk, size_t bytes) {
  return chunk->capacity >= bytes && (chunk->capacity == CHUNK_BYTES || bytes > CHUNK_BYTES);
}

/* Takes the first spare that fits; returns NULL if there is none. */
static struct output_chunk *take_spare(struct output *output, size_t bytes) {
  struct output_chunk **link = &output->spares;
  while (*link != NULL && !is_fit(*link, bytes)) {
    link = &(*link)->next;
  }
  struct output_chunk *chunk = *link;
  if (chunk != NULL) {
    *link = chunk->next;
    output->spare_bytes -= chunk->capacity;
    output->spares_used = true;
    *chunk = (struct output_chunk){.capacity = chunk->capacity};
  }
  return chunk;
}

static struct output_chunk *new_chunk(struct output *output, size_t bytes) {
  const size_t capacity = bytes > CHUNK_BYTES ? bytes : CHUNK_BYTES;
  if (output->first == NULL && capacity == CHUNK_BYTES) {
    server_take_base_bytes(output->server, capacity);
  } else if (!server_take_bytes(output->server, capacity)) {
    return NULL;
  }
  struct output_chunk *chunk = malloc(sizeof *chunk + capacity);
  if (chunk == NULL) {
    server_return_bytes(output->server, capacity);
    return NULL;
  }
  *chunk = (struct output_chunk){.capacity = capacity};
  return chunk;
}

static struct output_chunk *add_chunk(struct output *output, size_t bytes) {
  struct output_chunk *chunk = take_spare(output, bytes);
  if (chunk == NULL) {
    chunk = new_chunk(output, bytes);
  }
  if (chunk == NULL && output->spares != NULL) { /* too small, but they count against the budget */
    free_spares(output);
    chunk = new_chunk(output, bytes);
  }
  if (chunk == NULL) {
    return NULL;
  }
  if (output->last == NULL) {
    output->first = chunk;
  } else {
    output->last->next = chunk;
  }
  output->last = chunk;
  return chunk;
}

void output_release(struct output *output) {
  if (output->ready_bytes == 0 && output->reserved_bytes == 0) {
    output_free(output);
  }
}

uint8_t *output_reserve(struct output *output, size_t bytes) {
  assert(output->reserved_bytes == 0 && bytes > 0 && bytes % 8 == 0);
  struct output_chunk *chunk = output->last;
  if (chunk == NULL || chunk->capacity - chunk->committed < bytes) {
    chunk = add_chunk(output, bytes);
  }
  if (chunk == NULL) {
    return NULL;
  }
  output->reserved_bytes = bytes;
  return chunk->bytes + chunk->committed;
}

void output_commit(struct output *output) {
  output->last->committed += output->reserved_bytes;
  output->ready_bytes += output->reserved_bytes;
  output->reserved_bytes = 0;
}

void output_cancel(struct output *output) {
  output->reserved_bytes = 0;
}

size_t output_buffers(struct output *output, uv_buf_t *buffers, size_t count) {
  size_t used = 0;
  for (struct output_chunk *chunk = output->first; chunk != NULL && used < count;
       chunk = chunk->next) {
    if (chunk->committed > chunk->consumed) {
      buffers[used++] = uv_buf_init((char *)chunk->bytes + chunk->consumed,
                                    (unsigned)(chunk->committed - chunk->consumed));
    }
  }
  return used;
}

/* Removes the first chunk, which has been written entirely. The last chunk stays and is used again
 * if it is small. Returns whether another chunk has become the first. */
static bool finish_first(struct output *output) {
  struct output_chunk *chunk = output->first;
  if (chunk != output->last) {
    release_first(output);
    return true;
  }
  if (output->reserved_bytes == 0) {
    if (chunk->capacity == CHUNK_BYTES) {
      chunk->committed = chunk->consumed = 0;
    } else {
      release_first(output);
    }
  }
  return false;
}

void output_consume(struct output *output, uint64_t bytes) {
  assert(bytes <= output->ready_bytes);
  output->ready_bytes -= bytes;
  while (output->first != NULL) {
    struct output_chunk *chunk = output->first;
    const size_t there = chunk->committed - chunk->consumed;
    const size_t taken = bytes < there ? (size_t)bytes : there;
    chunk->consumed += taken;
    bytes -= taken;
    if (chunk->consumed < chunk->committed || !finish_first(output)) {
      return;
    }
  }
}
