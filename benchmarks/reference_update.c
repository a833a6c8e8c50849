/* The constitutive update in C, point by point: what the compiled kernel's speed is measured against.
 *
 * The same scheme as cosserat_fx/update.py (two implicit stages, Newton's method to the same tolerance, adapted
 * substeps, exact tangent), written as one writes it for one point: LU with partial pivoting, the system's exp and log.
 * N forces, STRESSES of them stresses, DRIVEN strains and curvatures, SPINS spins and TURNS entries of the spin terms
 * are macros, so that the compiler knows every loop.
 */
#include <math.h>
#include <string.h>

#define INPUTS (DRIVEN + SPINS)
#define GAMMA (1.0 - 0.70710678118654752440)
#define NEWTON_TOLERANCE 1e-7
#define NEWTON_ITERATIONS 25
#define HALVINGS 12

enum { OK = 0, LOOSE = 1, LOCAL_NEWTON = 2, SUBSTEPS = 3, RADICAND = 4, DENSE = 5, TENSION = 6, NOT_FINITE = 7 };

typedef struct {
    double e_i0, e_d0, e_c0, c_phi, h_s, alpha, beta, n, d50, a_c, h_i;
} Constants;

typedef struct {
    double weight[N], normal[N], share[N];
    int symmetric[N], slots[DRIVEN];
    int row[TURNS + 1], column[TURNS + 1], spin[TURNS + 1];
    double sign[TURNS + 1];
} Tables;

typedef struct {
    double d[N], w[SPINS + 1], norm, volume;
    double trace, f_s, f_d, a, power, log_f_s_by_trace, log_f_s_by_e, f_d_by_trace, f_d_by_e;
    double rate[N], material_rate[N], z[N], flow[N], alpha[N], a_by_y[N];
    double y[N], base[N], stage[N], correction[N], matrix[N][N];
    int pivots[N];
    double sensitivity[N][INPUTS], stage_sensitivity[N][INPUTS];
} Point;

static double critical_stress(double c_phi, const double s[6], double gradient[6])
{
    double j2 = s[0] * s[0] + s[1] * s[1] + s[2] * s[2] + 2.0 * (s[3] * s[3] + s[4] * s[4] + s[5] * s[5]);
    if (j2 < 1e-28) {
        memset(gradient, 0, 6 * sizeof(double));
        return c_phi * sqrt(8.0 / 3.0);
    }
    double q[6] = {
        s[0] * s[0] + s[3] * s[3] + s[4] * s[4], s[3] * s[3] + s[1] * s[1] + s[5] * s[5],
        s[4] * s[4] + s[5] * s[5] + s[2] * s[2], s[0] * s[3] + s[3] * s[1] + s[4] * s[5],
        s[0] * s[4] + s[3] * s[5] + s[4] * s[2], s[3] * s[4] + s[1] * s[5] + s[5] * s[2],
    };
    double j3 = s[0] * q[0] + s[1] * q[1] + s[2] * q[2] + 2.0 * (s[3] * q[3] + s[4] * q[4] + s[5] * q[5]);
    double lode = j3 / j2, numerator = 8.0 / 3.0 - 3.0 * (j2 + j3), denominator = 1.0 - 3.0 * lode;
    if (!(numerator > 1e-12 && denominator > 1e-12))
        return -1.0;
    double root = sqrt(numerator / denominator), norm = sqrt(j2);
    if (!(root > norm))
        return -1.0;
    double half = 0.5 / (root * denominator);
    double by_square = c_phi * half * (-9.0 + root * root * 9.0 / j2);
    double by_linear = c_phi * (half * (-6.0 - root * root * 6.0 * lode / j2) - 1.0 / norm);
    for (int k = 0; k < 6; k++)
        gradient[k] = by_linear * s[k] + by_square * q[k];
    return c_phi * (root - norm);
}

static int rate(Point *p, const double *y, double e, const Constants *c, const Tables *t)
{
    double trace = 0.0;
    for (int i = 0; i < N; i++)
        trace += t->normal[i] * y[i];
    if (!(trace < 0.0))
        return TENSION;
    double log_pressure = log(-trace / c->h_s), compression = exp(c->n * log_pressure), expand = exp(compression);
    double e_i = c->e_i0 / expand, relative = e * expand - c->e_d0;
    if (!(relative > 1e-12 * c->e_d0))
        return DENSE;
    double f_d = exp(c->alpha * log(relative / (c->e_c0 - c->e_d0)));
    double f_b = c->h_s / (c->n * c->h_i) * (1.0 + e_i) / e_i * (-trace / c->h_s) / compression;
    double f_s = exp(c->beta * log(e_i / e)) * f_b;
    double log_shrink_by_trace = -c->n * compression / trace, f_d_by_relative = c->alpha * f_d / relative;
    p->log_f_s_by_trace = (c->beta - 1.0 / (1.0 + e_i)) * log_shrink_by_trace + (1.0 - c->n) / trace;
    p->log_f_s_by_e = -c->beta / e;
    p->f_d_by_trace = -f_d_by_relative * e * expand * log_shrink_by_trace;
    p->f_d_by_e = f_d_by_relative * expand;
    double deviator[6] = {0}, gradient[6], power = 0.0;
    for (int i = 0; i < N; i++) {
        p->z[i] = y[i] / trace;
        power += t->weight[i] * p->z[i] * p->d[i];
    }
    for (int i = 0; i < STRESSES; i++)
        deviator[t->symmetric[i]] += t->share[i] * p->z[i] - t->normal[i] / 3.0;
    double a = critical_stress(c->c_phi, deviator, gradient);
    if (a < 0.0)
        return RADICAND;
    double along = 0.0;
    for (int i = 0; i < STRESSES; i++)
        along += t->weight[i] * gradient[t->symmetric[i]] * p->z[i];
    for (int i = 0; i < N; i++) {
        p->a_by_y[i] = i < STRESSES ? (t->weight[i] * gradient[t->symmetric[i]] - along * t->normal[i]) / trace : 0.0;
        p->alpha[i] = i < STRESSES ? a : c->a_c;
        p->flow[i] = 2.0 * p->z[i] - t->normal[i] / 3.0;
        p->material_rate[i] = f_s * (p->alpha[i] * p->alpha[i] * p->d[i] + power * p->z[i]
                                     + f_d * p->alpha[i] * p->norm * p->flow[i]);
        p->rate[i] = p->material_rate[i];
    }
    for (int k = 0; k < TURNS; k++)
        p->rate[t->row[k]] += t->sign[k] * p->w[t->spin[k]] * y[t->column[k]];
    p->trace = trace;
    p->f_s = f_s;
    p->f_d = f_d;
    p->a = a;
    p->power = power;
    return OK;
}

static void stage_matrix(Point *p, double scale, const Tables *t)
{
    for (int i = 0; i < N; i++) {
        double by_a = i < STRESSES ? p->f_s * (2.0 * p->a * p->d[i] + p->f_d * p->norm * p->flow[i]) : 0.0;
        double by_power = p->f_s * p->z[i] / p->trace;
        double diagonal = p->f_s * (p->power + 2.0 * p->f_d * p->alpha[i] * p->norm) / p->trace;
        double by_trace = p->log_f_s_by_trace * p->material_rate[i]
                          + p->f_s * p->f_d_by_trace * p->alpha[i] * p->norm * p->flow[i]
                          - by_power * p->power - diagonal * p->z[i];
        for (int j = 0; j < N; j++)
            p->matrix[i][j] = -scale * (by_a * p->a_by_y[j] + by_power * t->weight[j] * p->d[j]
                                        + by_trace * t->normal[j]);
        p->matrix[i][i] += 1.0 - scale * diagonal;
    }
    for (int k = 0; k < TURNS; k++)
        p->matrix[t->row[k]][t->column[k]] -= scale * t->sign[k] * p->w[t->spin[k]];
}

static int factorise(Point *p)
{
    for (int k = 0; k < N; k++) {
        int pivot = k;
        for (int i = k + 1; i < N; i++)
            if (fabs(p->matrix[i][k]) > fabs(p->matrix[pivot][k]))
                pivot = i;
        if (!(fabs(p->matrix[pivot][k]) > 0.0))
            return 0;
        p->pivots[k] = pivot;
        if (pivot != k)
            for (int j = 0; j < N; j++) {
                double kept = p->matrix[k][j];
                p->matrix[k][j] = p->matrix[pivot][j];
                p->matrix[pivot][j] = kept;
            }
        double inverse = 1.0 / p->matrix[k][k];
        for (int i = k + 1; i < N; i++) {
            p->matrix[i][k] *= inverse;
            for (int j = k + 1; j < N; j++)
                p->matrix[i][j] -= p->matrix[i][k] * p->matrix[k][j];
        }
    }
    return 1;
}

static inline void solve(const Point *p, double *columns, int m)
{
    for (int k = 0; k < N; k++)
        if (p->pivots[k] != k)
            for (int j = 0; j < m; j++) {
                double kept = columns[k * m + j];
                columns[k * m + j] = columns[p->pivots[k] * m + j];
                columns[p->pivots[k] * m + j] = kept;
            }
    for (int i = 1; i < N; i++)
        for (int k = 0; k < i; k++)
            for (int j = 0; j < m; j++)
                columns[i * m + j] -= p->matrix[i][k] * columns[k * m + j];
    for (int i = N - 1; i >= 0; i--) {
        for (int k = i + 1; k < N; k++)
            for (int j = 0; j < m; j++)
                columns[i * m + j] -= p->matrix[i][k] * columns[k * m + j];
        double inverse = 1.0 / p->matrix[i][i];
        for (int j = 0; j < m; j++)
            columns[i * m + j] *= inverse;
    }
}

static int solve_stage(Point *p, double e, double scale, int want_factors, const Constants *c, const Tables *t)
{
    int code = rate(p, p->stage, e, c, t);
    for (int k = 0; k < HALVINGS && code == DENSE; k++) {
        for (int i = 0; i < N; i++)
            p->stage[i] *= 2.0;
        code = rate(p, p->stage, e, c, t);
    }
    if (code)
        return code;
    for (int iteration = 0; iteration < NEWTON_ITERATIONS; iteration++) {
        for (int i = 0; i < N; i++)
            p->correction[i] = p->base[i] + scale * p->rate[i] - p->stage[i];
        stage_matrix(p, scale, t);
        if (!factorise(p))
            return LOCAL_NEWTON;
        solve(p, p->correction, 1);
        double damping = 1.0, candidate[N];
        for (int k = 0; k < HALVINGS; k++, damping *= 0.5) {
            for (int i = 0; i < N; i++)
                candidate[i] = p->stage[i] + damping * p->correction[i];
            code = rate(p, candidate, e, c, t);
            if (!code)
                break;
        }
        if (code)
            return code;
        memcpy(p->stage, candidate, sizeof candidate);
        int converged = damping == 1.0;
        for (int i = 0; i < N; i++)
            converged = converged && fabs(p->correction[i]) <= -NEWTON_TOLERANCE * p->trace;
        if (converged) {
            if (want_factors) {
                stage_matrix(p, scale, t);
                return factorise(p) ? OK : LOCAL_NEWTON;
            }
            return OK;
        }
    }
    return LOCAL_NEWTON;
}

static void add_input_derivative(Point *p, double scale, double e_by_volume, const Tables *t)
{
    double by_norm = p->norm > 0.0 ? 1.0 / p->norm : 0.0;
    for (int i = 0; i < N; i++) {
        double nonlinear = p->f_s * p->alpha[i] * p->flow[i];
        double by_e = p->log_f_s_by_e * p->material_rate[i] + p->f_d_by_e * p->norm * nonlinear;
        for (int k = 0; k < DRIVEN; k++) {
            int j = t->slots[k];
            p->stage_sensitivity[i][k] += scale * (p->f_s * p->z[i] * t->weight[j] * p->z[j]
                                                   + p->f_d * nonlinear * t->weight[j] * p->d[j] * by_norm
                                                   + by_e * e_by_volume * t->normal[j]);
        }
    }
    for (int k = 0; k < DRIVEN; k++)
        p->stage_sensitivity[t->slots[k]][k] += scale * p->f_s * p->alpha[t->slots[k]] * p->alpha[t->slots[k]];
    for (int k = 0; k < TURNS; k++)
        p->stage_sensitivity[t->row[k]][DRIVEN + t->spin[k]] += scale * t->sign[k] * p->stage[t->column[k]];
}

static int integrate(Point *p, double e_n, int substeps, int estimate, int want_tangent, double *worst,
                     const Constants *c, const Tables *t)
{
    const double ratio = (1.0 - GAMMA) / GAMMA;
    double before[N];
    *worst = 0.0;
    if (want_tangent)
        memset(p->sensitivity, 0, sizeof p->sensitivity);
    for (int step = 0; step < substeps; step++) {
        double begin = (double)step / substeps, end = (step + 1.0) / substeps;
        begin *= begin;
        double h = end * end - begin;
        if (estimate) {
            if (step == 0) {
                int code = rate(p, p->y, e_n, c, t);
                if (code)
                    return code;
            }
            memcpy(before, p->rate, sizeof before);
        }
        memcpy(p->base, p->y, sizeof p->y);
        memcpy(p->stage, p->y, sizeof p->y);
        if (want_tangent)
            memcpy(p->stage_sensitivity, p->sensitivity, sizeof p->sensitivity);
        for (int stage = 0; stage < 2; stage++) {
            double time = begin + (stage ? 1.0 : GAMMA) * h, e = (1.0 + e_n) * exp(time * p->volume) - 1.0;
            int code = solve_stage(p, e, GAMMA * h, want_tangent || (estimate && stage), c, t);
            if (code)
                return code;
            if (want_tangent) {
                add_input_derivative(p, GAMMA * h, (1.0 + e) * time, t);
                solve(p, p->stage_sensitivity[0], INPUTS);
            }
            if (stage == 0) {
                for (int i = 0; i < N; i++)
                    p->base[i] = p->y[i] + ratio * (p->stage[i] - p->y[i]);
                if (want_tangent)
                    for (int i = 0; i < N; i++)
                        for (int k = 0; k < INPUTS; k++)
                            p->stage_sensitivity[i][k] = p->sensitivity[i][k]
                                + ratio * (p->stage_sensitivity[i][k] - p->sensitivity[i][k]);
            }
        }
        if (estimate) {
            for (int i = 0; i < N; i++)
                p->correction[i] = 2.0 / 3.0 * ((p->base[i] - p->y[i]) / (1.0 - GAMMA) - (1.0 - GAMMA) * h * before[i]
                                                - (p->stage[i] - p->base[i]));
            solve(p, p->correction, 1);
            for (int i = 0; i < N; i++)
                *worst = fmax(*worst, -fabs(p->correction[i]) / p->trace);
        }
        memcpy(p->y, p->stage, sizeof p->y);
        if (want_tangent)
            memcpy(p->sensitivity, p->stage_sensitivity, sizeof p->sensitivity);
    }
    return OK;
}

/* The batch, with the arrays of cosserat_fx.update.build_update for points 0 to m - 1; returns the worst status. */
int update(long m, const Tables *t, const double *increments, const double *forces_n, const double *e_n, double *forces,
           double *e, double *tangent, int *substeps, unsigned char *status, double *error, const Constants *c,
           double tolerance, int max_substeps, int adapt, int want_tangent)
{
    Point p;
    int worst = OK;
    for (long q = 0; q < m; q++) {
        p.norm = p.volume = 0.0;
        memset(p.d, 0, sizeof p.d);
        for (int k = 0; k < DRIVEN; k++)
            p.d[t->slots[k]] = increments[q * INPUTS + k] * (t->slots[k] < STRESSES ? 1.0 : c->d50);
        for (int k = 0; k < SPINS; k++)
            p.w[k] = increments[q * INPUTS + DRIVEN + k];
        for (int i = 0; i < N; i++) {
            p.norm += t->weight[i] * p.d[i] * p.d[i];
            p.volume += t->normal[i] * p.d[i];
        }
        p.norm = sqrt(p.norm);
        int code = isfinite(p.norm) ? OK : NOT_FINITE;
        while (code != NOT_FINITE) {
            double estimate;
            for (int i = 0; i < N; i++)
                p.y[i] = forces_n[q * N + i] / (i < STRESSES ? 1.0 : c->d50);
            code = integrate(&p, e_n[q], substeps[q], adapt, want_tangent, &estimate, c, t);
            if (!adapt)
                break;
            error[q] = estimate;
            if (!code && estimate <= tolerance)
                break;
            if (substeps[q] >= max_substeps) {
                code = code ? code : SUBSTEPS;
                break;
            }
            double growth = code ? 2.0 : fmin(4.0, 1.1 * cbrt(estimate / tolerance));
            int more = (int)(growth * substeps[q]);
            more = more > substeps[q] ? more : substeps[q] + 1;
            substeps[q] = more < max_substeps ? more : max_substeps;
        }
        if (code) {
            memcpy(forces + q * N, forces_n + q * N, N * sizeof(double));
            e[q] = e_n[q];
            if (want_tangent)
                memset(tangent + q * DRIVEN * INPUTS, 0, DRIVEN * INPUTS * sizeof(double));
        } else {
            double trace = 0.0;
            for (int i = 0; i < N; i++) {
                forces[q * N + i] = p.y[i] * (i < STRESSES ? 1.0 : c->d50);
                trace += t->normal[i] * p.y[i];
            }
            e[q] = e_n[q] + (1.0 + e_n[q]) * expm1(p.volume);
            if (e[q] > c->e_i0 * exp(-pow(-trace / c->h_s, c->n)))
                code = LOOSE;
            if (want_tangent)
                for (int k = 0; k < DRIVEN; k++)
                    for (int j = 0; j < INPUTS; j++) {
                        double scale = t->slots[k] < STRESSES ? 1.0 : c->d50;
                        if (j < DRIVEN && t->slots[j] >= STRESSES)
                            scale *= c->d50;
                        tangent[(q * DRIVEN + k) * INPUTS + j] = scale * p.sensitivity[t->slots[k]][j];
                    }
        }
        status[q] = (unsigned char)code;
        worst = code > worst ? code : worst;
    }
    return worst;
}
