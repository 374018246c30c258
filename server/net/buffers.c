#include "server/net/buffers.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

/* ---- input ----------------------------------------------------------------------------------- */

/* A buffer begins with BASE_BYTES and grows for larger frames, at most by the factor GROWTH at a
 * time. */
enum { BASE_BYTES = 65536, GROWTH = 8 };

void input_init(struct input *input, struct server *server) {
  *input = (struct input){.server = server, .budget = &server->buffers};
}

void input_free(struct input *input) {
  budget_return(input->budget, input->capacity);
  free(input->bytes);
  free(input->marks);
  input->bytes = NULL;
  input->marks = NULL;
  input->mark_count = 0;
  input->capacity = input->begin = input->end = 0;
}

static bool resize(struct input *input, size_t capacity) {
  if (input->marks == NULL) {
    input->marks = malloc(INPUT_MARKS * sizeof *input->marks);
  }
  uint8_t *bytes = input->marks != NULL ? budget_resize(input->budget, input->bytes,
                                                        input->capacity, capacity, BASE_BYTES)
                                        : NULL;
  if (bytes != NULL) {
    input->bytes = bytes;
    input->capacity = capacity;
  }
  return bytes != NULL;
}

static size_t held(const struct input *input) {
  return input->end - input->begin;
}

/* Moves the bytes to the front of the buffer. This also aligns the first frame to 8, as payloads
 * need, after a refused frame whose length is not a multiple of 8. */
static void move_to_front(struct input *input) {
  if (input->begin > 0) {
    memmove(input->bytes, input->bytes + input->begin, held(input));
    input->end = held(input);
    input->begin = 0;
  }
}

/* Returns the buffer size that the first frame needs, but at most GROWTH times the present size.
 * The buffer grows only as bytes arrive, so that a header that claims a large frame costs no
 * memory. */
static size_t larger(const struct input *input) {
  wire_header header = {0};
  if (input->capacity == 0) {
    return BASE_BYTES;
  }
  wire_get_header(input->bytes + input->begin, &header);
  const size_t needed = WIRE_BYTES_header + (size_t)header.payload_bytes;
  const size_t most = GROWTH * input->capacity;
  const size_t least = 2 * input->capacity;
  return input->skip_bytes > 0 || needed < least ? least : needed < most ? needed : most;
}

size_t input_room(struct input *input, uint8_t **room) {
  if (held(input) == 0) {
    input->begin = input->end = 0;
  }
  if (input->end == input->capacity) {
    move_to_front(input);
  }
  if (input->end == input->capacity && !resize(input, larger(input))) {
    return 0;
  }
  *room = input->bytes + input->end;
  return input->capacity - input->end;
}

size_t input_room_behind(struct input *input, uint8_t **room) {
  *room = input->bytes + input->end;
  return input->capacity - input->end;
}

static void take_skipped(struct input *input) {
  const size_t skipped = input->skip_bytes < held(input) ? (size_t)input->skip_bytes : held(input);
  input->begin += skipped;
  input->skip_bytes -= skipped;
}

/* Returns the number of bytes up to which marks are not needed. Marks inside the first frame are
 * not needed, because only the time of a frame's last byte is requested. If there is no frame,
 * marks of removed bytes are not needed. */
static uint64_t useless_bytes(const struct input *input) {
  const uint64_t done = input->total_bytes - held(input);
  if (input->skip_bytes > 0 || held(input) < WIRE_BYTES_header) {
    return done;
  }
  wire_header header;
  wire_get_header(input->bytes + input->begin, &header);
  return done + WIRE_BYTES_header + header.payload_bytes - 1;
}

/* Drops the marks of the first `bytes` bytes of the connection. */
static void drop_marks(struct input *input, uint64_t bytes) {
  unsigned gone = 0;
  while (gone < input->mark_count && input->marks[gone].total_bytes <= bytes) {
    gone++;
  }
  input->mark_count -= gone;
  memmove(input->marks, input->marks + gone, input->mark_count * sizeof input->marks[0]);
}

/* Adds a mark for bytes that have arrived. If there is no room, as after many frames in many
 * pieces, the last mark also stands for the new bytes. Its time is then too early, never too late,
 * so that no deadline is noticed too late. */
static void mark(struct input *input, uint64_t now_ns) {
  drop_marks(input, useless_bytes(input));
  struct input_mark *last = &input->marks[input->mark_count > 0 ? input->mark_count - 1 : 0];
  if (input->mark_count > 0 && (last->ns == now_ns || input->mark_count == INPUT_MARKS)) {
    last->total_bytes = input->total_bytes;
  } else {
    input->marks[input->mark_count++] = (struct input_mark){input->total_bytes, now_ns};
  }
}

void input_arrived(struct input *input, size_t bytes, uint64_t now_ns) {
  input->end += bytes;
  input->total_bytes += bytes;
  mark(input, now_ns);
  take_skipped(input);
}

uint64_t input_arrival_ns(const struct input *input, const wire_header *header) {
  const uint64_t done = input->total_bytes - held(input);
  const uint64_t end = done + WIRE_BYTES_header + header->payload_bytes;
  unsigned i = 0;
  while (i + 1 < input->mark_count && input->marks[i].total_bytes < end) {
    i++;
  }
  return input->mark_count > 0 ? input->marks[i].ns : 0;
}

enum input_outcome input_frame(struct input *input, wire_header *header, const uint8_t **payload,
                               wire_error *error) {
  if (input->skip_bytes > 0 || held(input) < WIRE_BYTES_header) {
    return INPUT_INCOMPLETE;
  }
  if (input->begin % WIRE_ALIGNMENT != 0) {
    move_to_front(input);
  }
  wire_get_header(input->bytes + input->begin, header);
  const uint64_t most = input->server->options.max_frame_bytes;
  if (!wire_header_is_good(header, most)) {
    *error = wire_header_check(header, most);
    return error->status == WIRE_STATUS_BAD_MAGIC ? INPUT_LOST : INPUT_REFUSED;
  }
  if (held(input) - WIRE_BYTES_header < header->payload_bytes) {
    return INPUT_INCOMPLETE;
  }
  *payload = input->bytes + input->begin + WIRE_BYTES_header;
  return INPUT_FRAME;
}

void input_next(struct input *input, const wire_header *header) {
  input->skip_id = header->request_id;
  input->skip_bytes = WIRE_BYTES_header + (uint64_t)header->payload_bytes;
  take_skipped(input);
}

bool input_take(struct input *input, const wire_header *header, struct input_block *block) {
  const size_t frame_bytes = WIRE_BYTES_header + (size_t)header->payload_bytes;
  const uint8_t *frame = input->bytes + input->begin;
  if (frame_bytes <= BASE_BYTES || frame_bytes < input->capacity / 2) {
    uint8_t *bytes = budget_resize(input->budget, NULL, 0, frame_bytes, 0);
    if (bytes == NULL) {
      return false;
    }
    memcpy(bytes, frame, frame_bytes);
    *block = (struct input_block){bytes, frame_bytes, bytes + WIRE_BYTES_header};
    input_next(input, header);
    return true;
  }
  const size_t rest = held(input) - frame_bytes;
  struct input whole = *input;
  input->bytes = NULL;
  input->capacity = 0;
  if (!resize(input, rest > BASE_BYTES ? rest : BASE_BYTES)) {
    *input = whole;
    return false;
  }
  memcpy(input->bytes, frame + frame_bytes, rest);
  input->begin = 0;
  input->end = rest;
  *block = (struct input_block){whole.bytes, whole.capacity, frame + WIRE_BYTES_header};
  return true;
}

void input_free_block(struct input *input, struct input_block *block) {
  budget_return(input->budget, block->capacity);
  free(block->bytes);
  *block = (struct input_block){0};
}

bool input_refuse(struct input *input, wire_header *header) {
  if (input->skip_bytes > 0 || held(input) < WIRE_BYTES_header) {
    return false;
  }
  wire_get_header(input->bytes + input->begin, header);
  input_next(input, header);
  return true;
}

void input_release(struct input *input) {
  if (held(input) == 0) {
    input_free(input);
  }
}

void input_trim(struct input *input) {
  if (input->capacity > BASE_BYTES && held(input) <= BASE_BYTES) {
    move_to_front(input);
    resize(input, BASE_BYTES);
  }
}

bool input_partial(const struct input *input) {
  return input->skip_bytes > 0 || held(input) > 0;
}

uint64_t input_partial_id(const struct input *input) {
  wire_header header = {.request_id = input->skip_id};
  if (input->skip_bytes == 0) {
    header.request_id = 0;
    if (held(input) >= WIRE_BYTES_header) {
      wire_get_header(input->bytes + input->begin, &header);
    }
  }
  return header.request_id;
}

/* ---- output ---------------------------------------------------------------------------------- */

/* A chunk holds a few hundred small replies, which one system call then writes. */
enum { CHUNK_BYTES = 65536 };

struct output_chunk {
  struct output_chunk *next;
  size_t capacity;
  size_t committed;
  size_t consumed;
  _Alignas(16) uint8_t bytes[];
};

void output_init(struct output *output, struct server *server) {
  *output = (struct output){.server = server, .budget = &server->buffers};
}

static void release_first(struct output *output) {
  struct output_chunk *chunk = output->first;
  output->first = chunk->next;
  if (output->first == NULL) {
    output->last = NULL;
  }
  budget_return(output->budget, chunk->capacity);
  free(chunk);
}

void output_free(struct output *output) {
  while (output->first != NULL) {
    release_first(output);
  }
}

static struct output_chunk *add_chunk(struct output *output, size_t bytes) {
  const size_t capacity = bytes > CHUNK_BYTES ? bytes : CHUNK_BYTES;
  if (output->first == NULL && capacity == CHUNK_BYTES) {
    budget_take_base(output->budget, capacity);
  } else if (!budget_take(output->budget, capacity)) {
    return NULL;
  }
  struct output_chunk *chunk = malloc(sizeof *chunk + capacity);
  if (chunk == NULL) {
    budget_return(output->budget, capacity);
    return NULL;
  }
  *chunk = (struct output_chunk){.capacity = capacity};
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

/* Removes the first chunk, which has been written completely. If it is the only chunk and small, it
 * stays and is used again. Returns whether another chunk has become the first. */
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
