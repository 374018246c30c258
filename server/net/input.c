#include "server/net/input.h"

#include <stdlib.h>
#include <string.h>

/* A buffer begins with BASE_BYTES and grows for larger frames, at most by the factor GROWTH at a
 * time. */
enum { BASE_BYTES = 65536, GROWTH = 8, TRIM_MS = 1000 };

void input_init(struct input *input, struct server *server) {
  *input = (struct input){.server = server};
}

void input_free(struct input *input) {
  server_return_bytes(input->server, input->capacity);
  free(input->bytes);
  input->bytes = NULL;
  input->capacity = input->begin = input->end = 0;
}

static bool resize(struct input *input, size_t capacity) {
  if (capacity == BASE_BYTES && input->capacity == 0) {
    server_take_base_bytes(input->server, capacity);
  } else if (capacity > input->capacity &&
             !server_take_bytes(input->server, capacity - input->capacity)) {
    return false;
  }
  uint8_t *bytes = realloc(input->bytes, capacity);
  if (bytes == NULL) {
    if (capacity > input->capacity) {
      server_return_bytes(input->server, capacity - input->capacity);
    }
    return false;
  }
  if (capacity < input->capacity) {
    server_return_bytes(input->server, input->capacity - capacity);
  }
  input->bytes = bytes;
  input->capacity = capacity;
  return true;
}

static size_t held(const struct input *input) {
  return input->end - input->begin;
}

/* Payloads have to be aligned to 8. A refused frame whose length is no multiple of 8 leaves the
 * next frame unaligned; moving it to the front aligns it again. */
static void move_to_front(struct input *input) {
  if (input->begin > 0) {
    memmove(input->bytes, input->bytes + input->begin, held(input));
    input->end = held(input);
    input->begin = 0;
  }
}

/* The size that the frame in the buffer needs, but at most GROWTH times the present size. The
 * buffer grows as bytes arrive, so a header that claims a large frame costs nothing by itself. */
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
  input->large |= held(input) > BASE_BYTES / 2;
  *room = input->bytes + input->end;
  return input->capacity - input->end;
}

static void take_skipped(struct input *input) {
  const size_t skipped = input->skip_bytes < held(input) ? (size_t)input->skip_bytes : held(input);
  input->begin += skipped;
  input->skip_bytes -= skipped;
}

/* Marks up to this byte are not needed. Those inside the first frame are not, because only the time
 * of a frame's last byte is asked for. Without a frame, marks of removed bytes are not. */
static uint64_t useless_bytes(const struct input *input) {
  const uint64_t done = input->total_bytes - held(input);
  if (input->skip_bytes > 0 || held(input) < WIRE_BYTES_header) {
    return done;
  }
  wire_header header;
  wire_get_header(input->bytes + input->begin, &header);
  return done + WIRE_BYTES_header + header.payload_bytes - 1;
}

/* Drops the marks up to a byte. */
static void drop_marks(struct input *input, uint64_t bytes) {
  unsigned gone = 0;
  while (gone < input->mark_count && input->marks[gone].total_bytes <= bytes) {
    gone++;
  }
  input->mark_count -= gone;
  memmove(input->marks, input->marks + gone, input->mark_count * sizeof input->marks[0]);
}

/* If there is no room for another mark, the last one also stands for the new bytes. Its time is
 * then too early, so that deadlines are never noticed too late. This takes many frames that arrive
 * in many pieces. */
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
  input->skip_bytes = WIRE_BYTES_header + (uint64_t)header->payload_bytes;
  take_skipped(input);
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

void input_trim(struct input *input, uint64_t now_ms) {
  if (input->large) {
    input->large_ms = now_ms;
    input->large = false;
  } else if (input->capacity > BASE_BYTES && held(input) <= BASE_BYTES &&
             now_ms - input->large_ms > TRIM_MS) {
    move_to_front(input);
    resize(input, BASE_BYTES);
  }
}

void input_discard(struct input *input) {
  input->begin = input->end = 0;
  input->skip_bytes = 0;
}

bool input_partial(const struct input *input) {
  return input->skip_bytes > 0 || held(input) > 0;
}
