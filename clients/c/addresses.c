/* Several addresses: which there are, and one after the other. */
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "clients/c/client.h"

/* Where the next address begins, at its comma; NULL: there is no other. A comma that no scheme
 * follows is part of a path. */
static char *find_next(char *text) {
  static const char *const schemes[] = {",unix:", ",tcp:", ",private:"};
  for (char *comma = strchr(text, ','); comma != NULL; comma = strchr(comma + 1, ',')) {
    for (size_t i = 0; i < sizeof schemes / sizeof schemes[0]; i++) {
      if (strncmp(comma, schemes[i], strlen(schemes[i])) == 0) {
        return comma;
      }
    }
  }
  return NULL;
}

static bool check(const libdipole_addresses *addresses, dipole_error *error) {
  libdipole_address address;
  for (size_t i = 0; i < addresses->count; i++) {
    if (!libdipole_address_parse(addresses->texts[i], &address, error)) {
      return false;
    }
    if (address.kind == LIBDIPOLE_PRIVATE && addresses->count > 1) {
      return libdipole_fail(error, DIPOLE_ERROR_ADDRESS,
                            "address '%.80s': a private daemon is no address among others",
                            addresses->texts[i]);
    }
  }
  return true;
}

bool libdipole_addresses_parse(const char *text, libdipole_addresses *addresses,
                               dipole_error *error) {
  *addresses = (libdipole_addresses){.whole = strdup(text)};
  if (addresses->whole == NULL) {
    return libdipole_fail(error, DIPOLE_ERROR_MEMORY, "out of memory");
  }
  for (char *next = addresses->whole; next != NULL;) {
    if (addresses->count == DIPOLE_ADDRESSES_MAX) {
      return libdipole_fail(error, DIPOLE_ERROR_ADDRESS, "there are more than %d addresses",
                            DIPOLE_ADDRESSES_MAX);
    }
    addresses->texts[addresses->count++] = next;
    next = find_next(next);
    if (next != NULL) {
      *next++ = '\0';
    }
  }
  return check(addresses, error);
}

bool libdipole_addresses_is_private(const libdipole_addresses *addresses) {
  return strncmp(addresses->texts[0], "private:", strlen("private:")) == 0;
}

void libdipole_addresses_free(libdipole_addresses *addresses) {
  free(addresses->whole);
  *addresses = (libdipole_addresses){0};
}

/* xorshift64* (Vigna 2016), of whose 64 bits the upper half is good. */
uint32_t libdipole_random(uint64_t *state) {
  uint64_t x = *state;
  if (x == 0) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    x = ((uint64_t)now.tv_nsec << 32 ^ (uint64_t)(uintptr_t)state) | 1;
  }
  x ^= x >> 12;
  x ^= x << 25;
  x ^= x >> 27;
  *state = x;
  return (uint32_t)(x * UINT64_C(0x2545f4914f6cdd1d) >> 32);
}

unsigned libdipole_jitter(uint64_t *state, unsigned pause_ms) {
  return pause_ms - libdipole_random(state) % (pause_ms / 2 + 1);
}

unsigned libdipole_pause_twice(unsigned pause_ms) {
  return 2 * pause_ms < LIBDIPOLE_PAUSE_MOST_MS ? 2 * pause_ms : LIBDIPOLE_PAUSE_MOST_MS;
}
