#include "proto/digest.h"

#include <stdbool.h>
#include <string.h>

/* Words are copied between memory and state as they are. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "this machine's words need swapping");

enum { ROUNDS = 12, WORDS = 16 };

/* The square roots of the first primes, as in SHA-512 (RFC 7693, section 2.6). */
static const uint64_t initial[8] = {0x6a09e667f3bcc908, 0xbb67ae8584caa73b, 0x3c6ef372fe94f82b,
                                    0xa54ff53a5f1d36f1, 0x510e527fade682d1, 0x9b05688c2b3e6c1f,
                                    0x1f83d9abfb41bd6b, 0x5be0cd19137e2179};

/* The order of the words in each round (section 2.7). Rounds 10 and 11 repeat 0 and 1. */
static const uint8_t order[ROUNDS][WORDS] = {
    {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15},
    {14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3},
    {11, 8, 12, 0, 5, 2, 15, 13, 10, 14, 3, 6, 7, 1, 9, 4},
    {7, 9, 3, 1, 13, 12, 11, 14, 2, 6, 5, 10, 4, 0, 15, 8},
    {9, 0, 5, 7, 2, 4, 10, 15, 14, 1, 11, 12, 6, 8, 3, 13},
    {2, 12, 6, 10, 0, 11, 8, 3, 4, 13, 7, 5, 15, 14, 1, 9},
    {12, 5, 1, 15, 14, 13, 4, 10, 0, 7, 6, 3, 9, 2, 8, 11},
    {13, 11, 7, 14, 12, 1, 3, 9, 5, 0, 15, 4, 8, 6, 2, 10},
    {6, 15, 14, 9, 11, 3, 0, 8, 12, 2, 13, 7, 1, 4, 10, 5},
    {10, 2, 8, 4, 7, 6, 1, 5, 15, 11, 9, 14, 3, 12, 13, 0},
    {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15},
    {14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3}};

static uint64_t rotate(uint64_t word, unsigned bits) {
  return word >> bits | word << (64 - bits);
}

static void mix(uint64_t v[WORDS], unsigned a, unsigned b, unsigned c, unsigned d, uint64_t x,
                uint64_t y) {
  v[a] = v[a] + v[b] + x;
  v[d] = rotate(v[d] ^ v[a], 32);
  v[c] = v[c] + v[d];
  v[b] = rotate(v[b] ^ v[c], 24);
  v[a] = v[a] + v[b] + y;
  v[d] = rotate(v[d] ^ v[a], 16);
  v[c] = v[c] + v[d];
  v[b] = rotate(v[b] ^ v[c], 63);
}

/* Hashes one block. last: whether it is the last one, padded with zeros. */
static void hash_block(digest_state *digest, const uint8_t *block, bool last) {
  uint64_t v[WORDS], m[WORDS];
  memcpy(m, block, sizeof m);
  memcpy(v, digest->state, sizeof digest->state);
  memcpy(v + 8, initial, sizeof initial);
  v[12] ^= digest->hashed_bytes;
  v[14] ^= last ? UINT64_MAX : 0;
  for (unsigned i = 0; i < ROUNDS; i++) {
    const uint8_t *s = order[i];
    mix(v, 0, 4, 8, 12, m[s[0]], m[s[1]]);
    mix(v, 1, 5, 9, 13, m[s[2]], m[s[3]]);
    mix(v, 2, 6, 10, 14, m[s[4]], m[s[5]]);
    mix(v, 3, 7, 11, 15, m[s[6]], m[s[7]]);
    mix(v, 0, 5, 10, 15, m[s[8]], m[s[9]]);
    mix(v, 1, 6, 11, 12, m[s[10]], m[s[11]]);
    mix(v, 2, 7, 8, 13, m[s[12]], m[s[13]]);
    mix(v, 3, 4, 9, 14, m[s[14]], m[s[15]]);
  }
  for (unsigned i = 0; i < 8; i++) {
    digest->state[i] ^= v[i] ^ v[i + 8];
  }
}

void digest_start(digest_state *digest) {
  memcpy(digest->state, initial, sizeof initial);
  /* the parameter block without key and tree (section 2.8) */
  digest->state[0] ^= 0x01010000 ^ DIGEST_BYTES;
  digest->hashed_bytes = 0;
  digest->block_bytes = 0;
}

void digest_add(digest_state *digest, const void *bytes, size_t count) {
  const uint8_t *at = bytes;
  while (count > 0) {
    /* more bytes follow, so this is not the last block */
    if (digest->block_bytes == DIGEST_BLOCK_BYTES) {
      digest->hashed_bytes += DIGEST_BLOCK_BYTES;
      hash_block(digest, digest->block, false);
      digest->block_bytes = 0;
    }
    const size_t room = DIGEST_BLOCK_BYTES - digest->block_bytes;
    const size_t n = count < room ? count : room;
    memcpy(digest->block + digest->block_bytes, at, n);
    digest->block_bytes += n;
    at += n;
    count -= n;
  }
}

void digest_end(digest_state *digest, uint64_t name[2]) {
  memset(digest->block + digest->block_bytes, 0, DIGEST_BLOCK_BYTES - digest->block_bytes);
  digest->hashed_bytes += digest->block_bytes;
  hash_block(digest, digest->block, true);
  memcpy(name, digest->state, DIGEST_BYTES);
}
