/* Stand-in: parameters as a table that a test can look into. */
#pragma once

#include <stdint.h>

enum { PARAM_UINT8, PARAM_UINT16, PARAM_FLOAT, PARAM_UINT32, PARAM_RONLY = 64 };

typedef struct {
    const char *name;
    int type;
    void *address;
} param_t;

#define PARAM_GROUP_START(GROUP) const param_t params_##GROUP[] = {
#define PARAM_ADD(TYPE, NAME, ADDRESS) {#NAME, TYPE, ADDRESS},
#define PARAM_GROUP_STOP(GROUP) {0, 0, 0}};

extern const param_t params_mf[];
