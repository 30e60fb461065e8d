/* Straight-line functions of postures, evaluated for LANES postures at once.

   Before this text stand UNKNOWNS and KNOWN, the sizes of what goes in; behind it the functions,
   written by lanes.py. Rows of a batch are vectors; in a block, lane l is row first + l. */

#ifdef __AVX512F__
#define LANES 8
#else
#define LANES 4
#endif

typedef double real __attribute__((vector_size(8 * LANES)));
typedef long long whole __attribute__((vector_size(8 * LANES)));

static const real zero = {0};

static inline real pick(whole mask, real yes, real no)
{
    return (real)((mask & (whole)yes) | (~mask & (whole)no));
}

/* Reduced to a quarter turn about 0 (the multiple is exact below 2^20 of them; far angles are no
   posture and do not close), then Taylor's series, whose next terms are below rounding there. */
static __attribute__((noinline)) void turn(const real *angle, real *sine, real *cosine)
{
    const real shifted = *angle * 0.63661977236758134308 + 6755399441055744.0;
    const real quarters = shifted - 6755399441055744.0;
    const real x = *angle - quarters * 1.57079632673412561417 - quarters * 6.07710050650619224932e-11;
    const real z = x * x;
    const real odd = x + x * z * (-1 / 6. + z * (1 / 120. + z * (-1 / 5040. + z * (1 / 362880.
        + z * (-1 / 39916800. + z * (1 / 6227020800. + z * (-1 / 1307674368000.
        + z * (1 / 355687428096000.))))))));
    const real even = 1 - z * (1 / 2. - z * (1 / 24. - z * (1 / 720. - z * (1 / 40320.
        - z * (1 / 3628800. - z * (1 / 479001600. - z * (1 / 87178291200.
        - z * (1 / 20922789888000.))))))));
    const whole count = (whole)shifted, swap = -(count & 1);
    *sine = (real)((whole)pick(swap, even, odd) ^ ((count >> 1 & 1) << 63));
    *cosine = (real)((whole)pick(swap, odd, even) ^ ((count + 1 >> 1 & 1) << 63));
}

static void gather(long rows, long first, long width, const double *from, long stride, real *to)
{
    for (long lane = 0; lane < LANES; lane++) {
        const double *row = from + stride * (first + lane < rows ? first + lane : rows - 1);
        for (long k = 0; k < width; k++) ((double *)(to + k))[lane] = row[k];
    }
}

static void scatter(long rows, long first, long width, const real *from, double *to)
{
    for (long lane = 0; lane < LANES && first + lane < rows; lane++)
        for (long k = 0; k < width; k++)
            to[width * (first + lane) + k] = ((const double *)(from + k))[lane];
}

/* Rows of x are `stride` numbers apart: none where all postures share one. */
#define EACH(NAME, WIDTH)                                                                        \
    void NAME##_each(long rows, const double *x, long stride, const double *known, double *to)   \
    {                                                                                            \
        real at[UNKNOWNS], given[KNOWN], found[WIDTH];                                           \
        for (long first = 0; first < rows; first += LANES) {                                     \
            gather(rows, first, UNKNOWNS, x, stride, at);                                        \
            gather(rows, first, KNOWN, known, KNOWN, given);                                     \
            NAME(at, given, found);                                                              \
            scatter(rows, first, WIDTH, found, to);                                              \
        }                                                                                        \
    }

static void step(const real *restrict, const real *restrict, real *restrict);
static void residual(const real *restrict, const real *restrict, real *restrict);
static void outputs(const real *restrict, const real *restrict, real *restrict);
static void side(const real *restrict, const real *restrict, real *restrict);

/* Newton's method. A lane stands still once a step of it was below 1e-8, which leaves the square of
   that: what a posture gets does not depend on its neighbours. Found are the unknowns, their
   residual, the side and the number of steps. */
static void close(const real *restrict start, const real *restrict known, real *restrict found)
{
    real change[UNKNOWNS], steps = zero;
    whole moving = zero == zero;
    for (int k = 0; k < UNKNOWNS; k++) found[k] = start[k];
    for (int count = 0; count < 25; count++) {
        real largest = zero;
        long any = 0;
        step(found, known, change);
        steps += (real)((whole)(zero + 1) & moving);
        for (int k = 0; k < UNKNOWNS; k++) {
            const real size = pick(change[k] < zero, -change[k], change[k]);
            largest = pick(size <= largest, largest, size); /* or what is not a number */
            found[k] -= (real)((whole)change[k] & moving);
        }
        moving &= ~(largest < zero + 1e-8);
        for (int lane = 0; lane < LANES; lane++) any |= moving[lane];
        if (!any) break;
    }
    residual(found, known, found + UNKNOWNS);
    side(found, known, found + 2 * UNKNOWNS);
    found[2 * UNKNOWNS + 2] = steps;
}

/* All of a posture in one call. */
static void posture(const real *restrict start, const real *restrict known, real *restrict found)
{
    close(start, known, found);
    outputs(found, known, found + 2 * UNKNOWNS + 3);
}
