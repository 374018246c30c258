/* splitmix: the random numbers SplitMix64 (Steele, Lea, Flood 2014, "Fast splittable pseudorandom
 * number generators"), which are the same on every machine. */
#ifndef DIPOLED_CORE_SPLITMIX_H
#define DIPOLED_CORE_SPLITMIX_H

#include <stdint.h>

/* Returns the next number. A seed is any state. After i numbers from a seed, the state is seed + i
 * * 0x9e3779b97f4a7c15 modulo 2^64. */
static inline uint64_t core_splitmix(uint64_t *state) {
  uint64_t z = *state += UINT64_C(0x9e3779b97f4a7c15);
  z = (z ^ z >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
  z = (z ^ z >> 27) * UINT64_C(0x94d049bb133111eb);
  return z ^ z >> 31;
}

/* The same as a number from 0 to 1 - 2^-53, in steps of 2^-53. */
static inline double core_splitmix_f64(uint64_t *state) {
  return (double)(core_splitmix(state) >> 11) * 0x1p-53;
}

#endif
