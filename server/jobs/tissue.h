/* tissue: reads what a tissue is made of from a request. */
#ifndef DIPOLED_JOBS_TISSUE_H
#define DIPOLED_JOBS_TISSUE_H

#include "core/tissue/tissue.h"
#include "proto/wire.h"

/* Sets a tissue: the properties at `at`, `count` parameter structures, else those of the tissue with
 * this id. Core checks the values. */
wire_error tissue_read(core_tissue *tissue, unsigned id, unsigned haemoglobin, const uint8_t *at,
                       uint32_t count);

#endif
