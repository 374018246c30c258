/* The arrival time of a frame is the time of the read that brought its last byte. */
#include "server/net/buffers.h"
#include "tests/unit/unit.h"

static struct server server = {.options = {.max_frame_bytes = 1 << 20},
                               .buffers = {.most = 1 << 24}};

static void put(struct input *input, const uint8_t *bytes, size_t count, uint64_t now_ns) {
  uint8_t *room;
  assert_true(input_room(input, &room) >= count);
  memcpy(room, bytes, count);
  input_arrived(input, count, now_ns);
}

static size_t make_frame(uint8_t *to, uint32_t payload_bytes) {
  const wire_header header = {
      .magic = WIRE_MAGIC, .version = WIRE_VERSION, .type = 5, .payload_bytes = payload_bytes};
  wire_put_header(to, &header);
  memset(to + WIRE_BYTES_header, 0, payload_bytes);
  return WIRE_BYTES_header + (size_t)payload_bytes;
}

/* Returns the arrival time of the first frame, and removes the frame. */
static uint64_t take(struct input *input) {
  wire_header header;
  const uint8_t *payload;
  wire_error error;
  assert_int_equal(input_frame(input, &header, &payload, &error), INPUT_FRAME);
  const uint64_t ns = input_arrival_ns(input, &header);
  input_next(input, &header);
  return ns;
}

/* The frame arrives in many more pieces than there are marks. */
UNIT_TEST(a_frame_in_pieces_arrives_with_the_last) {
  struct input input;
  uint8_t frame[4096];
  const size_t bytes = make_frame(frame, 1000);
  input_init(&input, &server);
  for (int round = 0; round < 3; round++) {
    for (size_t i = 0; i < bytes; i++) {
      put(&input, frame + i, 1, 1000 * (uint64_t)(round + 1) * bytes + i);
    }
    assert_int_equal(take(&input), 1000 * (uint64_t)(round + 1) * bytes + bytes - 1);
  }
  input_free(&input);
}

UNIT_TEST(frames_of_one_read_arrive_together_and_others_do_not) {
  struct input input;
  uint8_t frames[256];
  size_t bytes = make_frame(frames, 8);
  bytes += make_frame(frames + bytes, 0);
  input_init(&input, &server);
  put(&input, frames, bytes, 100);
  put(&input, frames, bytes - 5, 200);
  put(&input, frames + bytes - 5, 5, 300);
  put(&input, frames, bytes, 300);
  assert_int_equal(take(&input), 100);
  assert_int_equal(take(&input), 100);
  assert_int_equal(take(&input), 200);
  assert_int_equal(take(&input), 300);
  assert_int_equal(take(&input), 300);
  assert_int_equal(take(&input), 300);
  input_free(&input);
}

/* If there are more reads than marks while frames wait, arrival times are never too late, and in
 * order. */
UNIT_TEST(without_marks_it_is_earlier) {
  enum { FRAMES = 3 * INPUT_MARKS };
  struct input input;
  uint8_t frame[64];
  const size_t bytes = make_frame(frame, 0);
  input_init(&input, &server);
  for (uint64_t i = 0; i < FRAMES; i++) {
    put(&input, frame, bytes, 100 + i);
  }
  uint64_t last_ns = 0;
  for (uint64_t i = 0; i < FRAMES; i++) {
    const uint64_t ns = take(&input);
    assert_true(ns >= last_ns && ns <= 100 + i);
    assert_true(i >= INPUT_MARKS || ns == 100 + i);
    last_ns = ns;
  }
  input_free(&input);
}
