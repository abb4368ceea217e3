/* Stand-in: log variables as a table that a test can look into. */
#pragma once

#include <stdint.h>

enum { LOG_UINT8, LOG_UINT32, LOG_FLOAT };

typedef struct {
    const char *name;
    int type;
    void *address;
} log_t;

#define LOG_GROUP_START(GROUP) const log_t logs_##GROUP[] = {
#define LOG_ADD(TYPE, NAME, ADDRESS) {#NAME, TYPE, ADDRESS},
#define LOG_GROUP_STOP(GROUP) {0, 0, 0}};

extern const log_t logs_mf[];
