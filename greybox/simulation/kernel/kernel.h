#include <math.h>
#include <string.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#define INLINE static inline __attribute__((always_inline))
/* Loops over rows of matrices, in vector instructions also where the rest is compiled in a hurry. */
#if defined(__GNUC__) && !defined(__clang__)
#define VECTORISED __attribute__((optimize("tree-vectorize")))
#else
#define VECTORISED
#endif
/* What a loop over a record needs beside its arguments: nothing where sizes and routines are compiled in. */
#ifndef CONTEXT
#define CONTEXT
#define PASS
#define ROUTINE(name, once) struct name##_once once
#endif
#define AT_LEAST_ONE(n) ((n) > 0 ? (n) : 1)
/* a * b + c, rounded once where the processor has an instruction for it. The compiler fuses nothing by itself. */
#ifdef __FP_FAST_FMA
#define FMA(a, b, c) __builtin_fma(a, b, c)
#else
#define FMA(a, b, c) ((a) * (b) + (c))
#endif
