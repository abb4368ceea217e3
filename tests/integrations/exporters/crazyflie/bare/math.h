/* Stand-in where a compiler for the drone's processor comes without a C library: enough to compile with, nothing to link with. */
#pragma once

#define isfinite(number) __builtin_isfinite(number)

float atan2f(float y, float x);
float asinf(float sine);
float cosf(float angle);
float fabsf(float number);
float sinf(float angle);
float sqrtf(float number);
