#include <math.h>
#include <string.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#define INLINE static inline __attribute__((always_inline))
#define AT_LEAST_ONE(n) ((n) > 0 ? (n) : 1)
/* a * b + c, rounded once where the processor has an instruction for it. The compiler fuses nothing by itself. */
#ifdef __FP_FAST_FMA
#define FMA(a, b, c) __builtin_fma(a, b, c)
#else
#define FMA(a, b, c) ((a) * (b) + (c))
#endif
