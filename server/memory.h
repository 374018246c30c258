/* memory: counts what is taken from the heap, so that a test can see that answering takes nothing. */
#ifndef DIPOLED_MEMORY_H
#define DIPOLED_MEMORY_H

#include <stdint.h>

/* Makes libuv's share count, too; before anything of libuv is called. */
void memory_count(void);

/* Calls of malloc(), calloc() and realloc() by the daemon and by libuv, since the start. */
uint64_t memory_allocations(void);

#endif
