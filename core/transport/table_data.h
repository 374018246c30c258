/* table_data: the bytes of transport.table, as part of the program's read-only data. */
#ifndef DIPOLED_CORE_TRANSPORT_TABLE_DATA_H
#define DIPOLED_CORE_TRANSPORT_TABLE_DATA_H

#include <stdint.h>

#pragma GCC visibility push(hidden)
extern const uint8_t transport_table_data[];
extern const uint8_t transport_table_data_end[];
#pragma GCC visibility pop

#endif
