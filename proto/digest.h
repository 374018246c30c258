/* digest: names content by its hash: BLAKE2b with 16 bytes (Saarinen and Aumasson 2015, RFC 7693),
 * which is hashlib.blake2b(..., digest_size=16) of Python. It has no key.
 *
 * The algorithm is written out here, because a client library without TLS links nothing else that
 * has it.
 */
#ifndef DIPOLED_PROTO_DIGEST_H
#define DIPOLED_PROTO_DIGEST_H

#include <stddef.h>
#include <stdint.h>

enum { DIGEST_BYTES = 16, DIGEST_BLOCK_BYTES = 128 };

typedef struct digest_state {
  uint64_t state[8];
  uint64_t hashed_bytes; /* number of bytes in the blocks that have been hashed */
  uint8_t block[DIGEST_BLOCK_BYTES];
  size_t block_bytes; /* number of bytes in the block that has not been hashed yet */
} digest_state;

void digest_start(digest_state *digest);

/* Adds bytes to the content. How it is cut into calls makes no difference. */
void digest_add(digest_state *digest, const void *bytes, size_t count);

/* Sets `name` to the hash of all that was added, as two little-endian numbers. */
void digest_end(digest_state *digest, uint64_t name[2]);

#endif
