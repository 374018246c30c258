#include "server/modbus/receiver.h"

#include <assert.h>
#include <string.h>

/* After this many equal replies, the receiver learns again whether there is an echo. If it were
 * wrong about the echo, the daemon could reply to itself forever. */
enum { REPEATS_MOST = 64 };

/* Drops the first bytes that are kept. */
static void drop(struct modbus_receiver *receiver, size_t bytes) {
  assert(bytes <= receiver->count);
  receiver->count -= bytes;
  receiver->fresh -= receiver->fresh < bytes ? receiver->fresh : bytes;
  receiver->late -= receiver->late < bytes ? receiver->late : bytes;
  memmove(receiver->bytes, receiver->bytes + bytes, receiver->count);
}

void modbus_receiver_reset(struct modbus_receiver *receiver) {
  drop(receiver, receiver->count);
  receiver->sent_count = 0;
  receiver->echo = MODBUS_ECHO_UNKNOWN;
}

/* ---- echo ------------------------------------------------------------------------------------ */

bool modbus_receiver_sent(struct modbus_receiver *receiver, const uint8_t *frame, size_t bytes) {
  assert(bytes >= MODBUS_RTU_MIN && bytes <= MODBUS_RTU_MAX);
  const bool ambiguous = modbus_pdu_bytes(frame + 1, bytes - 3) == bytes - 3; /* or a request */
  receiver->repeats = memcmp(receiver->sent, frame, bytes) == 0 ? receiver->repeats + 1 : 0;
  if (receiver->repeats == REPEATS_MOST) {
    receiver->repeats = 0;
    receiver->echo = MODBUS_ECHO_UNKNOWN;
  }
  drop(receiver, receiver->count);
  memcpy(receiver->sent, frame, bytes);
  receiver->sent_count = ambiguous && receiver->echo == MODBUS_ECHO_NONE ? 0 : bytes;
  return ambiguous && receiver->echo == MODBUS_ECHO_UNKNOWN;
}

/* Returns whether the bytes that have arrived begin with the frame that was sent, or are the
 * beginning of it. */
static bool begins_with_sent(const struct modbus_receiver *receiver) {
  const size_t most =
      receiver->count < receiver->sent_count ? receiver->count : receiver->sent_count;
  return most > 0 && memcmp(receiver->bytes, receiver->sent, most) == 0;
}

/* Notes that there was no echo: other bytes have arrived, or none. */
static void miss_echo(struct modbus_receiver *receiver) {
  receiver->sent_count = 0;
  receiver->echo = receiver->echo == MODBUS_ECHO_HEARD ? MODBUS_ECHO_UNKNOWN : MODBUS_ECHO_NONE;
}

void modbus_receiver_probed(struct modbus_receiver *receiver) {
  if (begins_with_sent(receiver)) {
    receiver->echo = MODBUS_ECHO_HEARD;
  } else {
    miss_echo(receiver);
  }
}

/* Skips the echo. Returns false if only the beginning of it has arrived. */
static bool take_echo(struct modbus_receiver *receiver, struct modbus_burst *burst) {
  if (receiver->sent_count == 0 || receiver->count == 0) {
    return true;
  }
  if (!begins_with_sent(receiver)) {
    burst->bad = receiver->fresh > 0; /* Bytes before the echo were noise. */
    miss_echo(receiver);
    return true;
  }
  if (receiver->count < receiver->sent_count) {
    receiver->fresh = receiver->late = receiver->count;
    return false;
  }
  drop(receiver, receiver->sent_count);
  receiver->sent_count = 0;
  receiver->echo = MODBUS_ECHO_HEARD;
  burst->echoed = true;
  return true;
}

/* ---- reading --------------------------------------------------------------------------------- */

uint8_t *modbus_receiver_room(struct modbus_receiver *receiver, size_t *room) {
  if (receiver->count == sizeof receiver->bytes) {
    const struct modbus_rtu_frames frames = modbus_rtu_split(receiver->bytes, receiver->count);
    drop(receiver, frames.bytes > 0 ? frames.bytes : receiver->count);
  }
  *room = sizeof receiver->bytes - receiver->count;
  return receiver->bytes + receiver->count;
}

void modbus_receiver_arrived(struct modbus_receiver *receiver, size_t count, uint64_t now_ns) {
  assert(count <= sizeof receiver->bytes - receiver->count);
  if (receiver->count > receiver->fresh && now_ns - receiver->arrived_ns >= receiver->silence_ns) {
    receiver->late = receiver->count;
  }
  receiver->count += count;
  receiver->arrived_ns = now_ns;
}

/* Finds frames that begin after a silence, at *begin, and reach to the end of the bytes that have
 * arrived. Returns false if there are none. */
static bool find_frames(const struct modbus_receiver *receiver, size_t *begin,
                        struct modbus_rtu_frames *frames) {
  const size_t begins[] = {0, receiver->fresh, receiver->late};
  for (size_t i = 0; i < sizeof begins / sizeof begins[0]; i++) {
    *begin = begins[i];
    *frames = modbus_rtu_split(receiver->bytes + *begin, receiver->count - *begin);
    if (frames->count > 0 && *begin + frames->bytes == receiver->count) {
      return true;
    }
  }
  return false;
}

bool modbus_receiver_is_whole(const struct modbus_receiver *receiver) {
  size_t begin;
  struct modbus_rtu_frames frames;
  if (begins_with_sent(receiver)) {
    frames = modbus_rtu_split(
        receiver->bytes + receiver->sent_count,
        receiver->count < receiver->sent_count ? 0 : receiver->count - receiver->sent_count);
    return receiver->sent_count + frames.bytes == receiver->count;
  }
  return find_frames(receiver, &begin, &frames);
}

/* Counts the complete frames, and keeps the bytes behind them, whose frame may go on. */
static void keep_unfinished(struct modbus_receiver *receiver, struct modbus_burst *burst) {
  const struct modbus_rtu_frames frames =
      modbus_rtu_split(receiver->bytes + receiver->fresh, receiver->count - receiver->fresh);
  const size_t begin = receiver->fresh + frames.bytes;
  burst->bad = true;
  drop(receiver, receiver->count - begin < MODBUS_RTU_MAX ? begin : receiver->count);
  receiver->fresh = receiver->late = receiver->count;
}

void modbus_receiver_end(struct modbus_receiver *receiver, struct modbus_burst *burst) {
  *burst = (struct modbus_burst){0};
  if (!take_echo(receiver, burst) || receiver->count == receiver->fresh) {
    return;
  }
  size_t begin;
  struct modbus_rtu_frames frames;
  if (!find_frames(receiver, &begin, &frames)) {
    keep_unfinished(receiver, burst);
    return;
  }
  burst->bad |= begin > receiver->fresh;
  const uint8_t *last = receiver->bytes + begin + frames.last;
  if (begin + frames.last >= receiver->fresh && (last[0] == receiver->number || last[0] == 0) &&
      last[1] < 0x80) {
    burst->bytes = frames.bytes - frames.last;
    memcpy(burst->request, last, burst->bytes);
  }
  drop(receiver, receiver->count);
}
