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
