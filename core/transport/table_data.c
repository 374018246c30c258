/* The assembler includes the file transport.table: no array needs compiling, and the program needs
 * no path to a file at run time. */
#include "core/transport/table_data.h"

__asm__(".pushsection .rodata\n"
        ".balign 16\n"
        ".globl transport_table_data\n"
        ".hidden transport_table_data\n"
        ".type transport_table_data, %object\n"
        "transport_table_data:\n"
        ".incbin \"core/transport/transport.table\"\n"
        ".globl transport_table_data_end\n"
        ".hidden transport_table_data_end\n"
        "transport_table_data_end:\n"
        ".byte 0\n"
        ".size transport_table_data, transport_table_data_end - transport_table_data\n"
        ".popsection\n");
