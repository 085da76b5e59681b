/* Blocks of W tangents. vu is the same in memory that is only aligned as doubles are. */
typedef double v __attribute__((vector_size(8 * W), may_alias));
typedef double vu __attribute__((vector_size(8 * W), aligned(8), may_alias));
typedef long long mask __attribute__((vector_size(8 * W)));
static const v zero = {0};

/* One tangent or the other, without arithmetic on the one not chosen: it may be infinite. */
INLINE v pick(int condition, v yes, v no)
{
    const mask all = (mask){0} - (long long)condition;
    return (v)(((mask)yes & all) | ((mask)no & ~all));
}

/* The same on a scalar and two blocks. */
#ifdef __has_builtin
#if __has_builtin(__builtin_elementwise_fma)
#define FMA_BLOCK __builtin_elementwise_fma
#endif
#endif
#if defined(__FMA__) && !defined(FMA_BLOCK)
#if W == 2
#define FMA_BLOCK __builtin_ia32_vfmaddpd
#elif W == 4
#define FMA_BLOCK __builtin_ia32_vfmaddpd256
#elif W == 8 && defined(__AVX512F__)
#define FMA_BLOCK(a, b, c) __builtin_ia32_vfmaddpd512_mask(a, b, c, -1, 4)
#endif
#endif
INLINE v FMA_LANES(double a, v b, v c)
{
#if defined(__FP_FAST_FMA) && defined(FMA_BLOCK)
    return FMA_BLOCK(a - zero, b, c);
#else
    return a * b + c;
#endif
}
