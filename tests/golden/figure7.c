// figure7: a robot controller, written by servolve transpile; do not edit.
//
//   controller  figure7
//   program     a6d9474c72a6eebd7b376ef9cd21d0058ec9a4fbde67b184898cdf29c4450ee6
//   generator   3

#include "figure7.h"

#if figure7_GENERATOR != 3 || figure7_FINGERPRINT != 0xe74291c5
#error "figure7.h and figure7.c are not of the same run: generate both again"
#endif

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "this controller needs IEEE-754 arithmetic: compile without -ffast-math, -Ofast and -ffinite-math-only"
#endif
#if defined(__FLT_EVAL_METHOD__) && __FLT_EVAL_METHOD__ != 0 && __FLT_EVAL_METHOD__ != 16
#error "this controller needs floats rounded to float: compile with -msse2 -mfpmath=sse, or for an FPU with float"
#endif

// a * b + c must round twice, also where the compiler's default is to fuse it (gcc -std=gnu11)
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#endif

void figure7_init(figure7_state* state) {
  state->s[0] = 0.0F;
}

void figure7_step(figure7_state* state, const float inputs[figure7_ninput], float outputs[figure7_noutput]) {
  const float in_t = inputs[figure7_input_t];
  const float in_a0 = inputs[figure7_input_a0];
  const float in_a1 = inputs[figure7_input_a1];
  const float in_a2 = inputs[figure7_input_a2];
  const float in_s0 = inputs[figure7_input_s0];
  const float in_px = inputs[figure7_input_px];
  const float in_pz = inputs[figure7_input_pz];
  const float in_vx = inputs[figure7_input_vx];
  const float in_vz = inputs[figure7_input_vz];
  (void)state;
  const float v0 = in_a0 < 0.0F ? in_pz : in_a2;  // (ifltz a0 pz a2)
  const float v1 = in_t == 0.0F ? 1.0F : in_a1 / in_t;  // (% a1 t)
  const float v2 = v0 - v1;  // (- (ifltz a0 pz a2) (% a1 t))
  const float v3 = in_a2 + 15.4962997F;  // (+ a2 15.4963)
  const float v4 = in_a2 == 0.0F ? 1.0F : in_a1 / in_a2;  // (% a1 a2)
  const float v5 = v3 < 0.0F ? v0 : v4;  // (ifltz (+ a2 15.4963) (ifltz a0 pz a2) (% a1 a2))
  const float v6 = v2 - v5;  // (- (- (ifltz a0 pz a2) (% a1 t)) (ifltz (+ a2 15.4963) (ifltz a0 pz a2) (% a1 a2)))
  const float v7 = in_s0 - in_vx;  // (- s0 vx)
  const float v8 = in_a2 + in_s0;  // (+ a2 s0)
  const float v9 = v8 == 0.0F ? 1.0F : v7 / v8;  // (% (- s0 vx) (+ a2 s0))
  const float v10 = in_a1 - in_a1;  // (- a1 a1)
  const float v11 = in_a1 - in_t;  // (- a1 t)
  const float v12 = v10 + v11;  // (+ (- a1 a1) (- a1 t))
  const float v13 = v9 < 0.0F ? v9 : v12;  // (ifltz (% (- s0 vx) (+ a2 s0)) (% (- s0 vx) (+ a2 s0)) (+ (- a1 a1) (- a1 t)))
  const float v14 = in_a1 + in_vz;  // (+ a1 vz)
  const float v15 = in_a1 * in_pz;  // (* a1 pz)
  const float v16 = in_pz == 0.0F ? 1.0F : in_a0 / in_pz;  // (% a0 pz)
  const float v17 = in_a0 == 0.0F ? 1.0F : in_px / in_a0;  // (% px a0)
  const float v18 = v15 < 0.0F ? v16 : v17;  // (ifltz (* a1 pz) (% a0 pz) (% px a0))
  const float v19 = v18 == 0.0F ? 1.0F : v14 / v18;  // (% (+ a1 vz) (ifltz (* a1 pz) (% a0 pz) (% px a0)))
  const float v20 = v6 < 0.0F ? v13 : v19;  // (ifltz v6 v13 (% (+ a1 vz) (ifltz (* a1 pz) (% a0 pz) (% px a0))))
  const float v21 = in_a0 == 0.0F ? 1.0F : in_vx / in_a0;  // (% vx a0)
  const float v22 = in_vx == 0.0F ? 1.0F : in_vx / in_vx;  // (% vx vx)
  const float v23 = v21 - v22;  // (- (% vx a0) (% vx vx))
  const float v24 = in_t + (-28.4382F);  // (+ t -28.4382)
  const float v25 = v24 - v1;  // (- (+ t -28.4382) (% a1 t))
  const float v26 = v21 - v25;  // (- (% vx a0) (- (+ t -28.4382) (% a1 t)))
  const float v27 = in_s0 * 16.5265999F;  // (* s0 16.5266)
  const float v28 = v23 < 0.0F ? v26 : v27;  // (ifltz (- (% vx a0) (% vx vx)) (- (% vx a0) (- (+ t -28.4382) (% a1 t))) (* s0 16.5266))
  const float v29 = in_s0 < 0.0F ? v28 : in_vz;  // (ifltz s0 v28 vz)
  const float v30 = v29 - v14;  // (- (ifltz s0 v28 vz) (+ a1 vz))
  outputs[figure7_output_a0] = v2;
  outputs[figure7_output_a1] = v20;
  outputs[figure7_output_a2] = v30;
}

static float figure7_limit(float value, float low, float high, float neutral) {
  if (value != value) {
    return neutral;
  }
  if (value < low) {
    return low;
  }
  return value > high ? high : value;
}

void figure7_clamp(float outputs[figure7_noutput]) {
  outputs[figure7_output_a0] = figure7_limit(outputs[figure7_output_a0], (-60.7000008F), 60.7000008F, 0.0F);
  outputs[figure7_output_a1] = figure7_limit(outputs[figure7_output_a1], (-65.6999969F), 65.6999969F, 0.0F);
  outputs[figure7_output_a2] = figure7_limit(outputs[figure7_output_a2], (-65.6999969F), 65.6999969F, 0.0F);
}

void figure7_command(figure7_state* state, const float outputs[figure7_noutput], float command[figure7_noutput]) {
  (void)state;
  command[figure7_output_a0] = outputs[figure7_output_a0];
  command[figure7_output_a1] = outputs[figure7_output_a1];
  command[figure7_output_a2] = outputs[figure7_output_a2];
  figure7_clamp(command);
  command[figure7_output_a0] = command[figure7_output_a0] * 0.0174532924F;
  command[figure7_output_a1] = command[figure7_output_a1] * 0.0174532924F;
  command[figure7_output_a2] = command[figure7_output_a2] * 0.0174532924F;
}

// the reference's inputs, as bits, step by step
static const uint32_t figure7_recorded_inputs[24][figure7_ninput] = {
    {0x40bbfec4U, 0xbf3defbbU, 0xbf847f8eU, 0xbd5c31efU, 0x413b146cU, 0xbeffc005U, 0x3ed4354aU, 0xbf97d778U,
     0x3f8822c3U},
    {0x40b5da44U, 0xbf77ef18U, 0x3f49e5d0U, 0xbf11302aU, 0x41ed05e5U, 0xbeec3010U, 0x3c495644U, 0xbf745adbU,
     0xbf7a3324U},
    {0x411b201bU, 0xbf37ca18U, 0x3f04e2d0U, 0x3efbe284U, 0x40492da6U, 0x3f353d2eU, 0x3ef9fe71U, 0xbf88e3fcU,
     0x3f8093b4U},
    {0x40d86087U, 0xbf1da6afU, 0xbf7e0a59U, 0xbe4715fdU, 0x4098718aU, 0xbf40242bU, 0x3f152c05U, 0xbfacd9faU,
     0x3e9fc213U},
    {0x40a0debdU, 0xbf48d739U, 0xbe11e9a0U, 0xbca3f57aU, 0x41712d26U, 0xbe987438U, 0x3e900ceaU, 0x3fe1681cU,
     0xbf5ce107U},
    {0x40e988ccU, 0xbf8199a4U, 0xbf8d7adcU, 0x3f4727faU, 0x413f8539U, 0x3f588d6bU, 0x3e060092U, 0xbff64cfcU,
     0x3fddd7d0U},
    {0x40af58d0U, 0x3f4578e2U, 0xbf46cb3eU, 0x3e6d6161U, 0x405549c4U, 0x3f44149aU, 0x3d8246b6U, 0xbf996b0fU,
     0xbd9c4c0cU},
    {0x3f970024U, 0xbf463028U, 0x3ebf175bU, 0xbe6fe7fbU, 0x4181952eU, 0x3f4611faU, 0x3eda07eeU, 0x3f8807e7U,
     0x3fa98bc1U},
    {0x409943faU, 0x3ef01e6cU, 0x3e438881U, 0x3d68554aU, 0x41a8915eU, 0xbf45e05eU, 0x3e9c4b63U, 0x3fbbc01cU,
     0xbf8e2528U},
    {0x411905a2U, 0x3d428aaaU, 0x3f4dcfbdU, 0x3e53918fU, 0x412279f8U, 0x3ea85c6aU, 0x3ef88192U, 0x3f352159U,
     0xbeeb0ab6U},
    {0x3f8ce6aaU, 0xbf47c938U, 0x3f8c935dU, 0xbe4fbda4U, 0x41512fb3U, 0xbf3ef9ccU, 0x3e98b707U, 0xbf140432U,
     0xbfa559f1U},
    {0x411aa4e5U, 0x3f25c89fU, 0x3f26e61aU, 0x3f1d6e57U, 0x41b9bb07U, 0x3f10bf3aU, 0x3d7f0fd1U, 0xbfdaccfdU,
     0xbfa19fa3U},
    {0x3ffee39fU, 0x3edf7efaU, 0x3f8d6c35U, 0xb4bc139dU, 0xc0400000U, 0x5799ccdcU, 0x00800000U, 0xbf800000U,
     0xbe8b10afU},
    {0x41029ee1U, 0x3eaf042dU, 0x3f83282aU, 0x3f285b52U, 0x40000000U, 0x3e7d92e5U, 0xc0400000U, 0x3e0f87c4U,
     0x3fd05b54U},
    {0x4086b348U, 0xbf668a9eU, 0x5127222cU, 0x88ab346bU, 0x41848337U, 0xbcca76d2U, 0x3ec06ec4U, 0x184b28f2U,
     0xbfc8362aU},
    {0x4044e9afU, 0x3b92a1adU, 0x3f837c5eU, 0xbf60cd3eU, 0x41b67de7U, 0xbf6e8412U, 0x40400000U, 0xbf23decdU,
     0x3fccd476U},
    {0x3fba72b7U, 0x070cd526U, 0xbf08c4c2U, 0x3f62cf36U, 0xeafac304U, 0x18fd21d2U, 0x7826e0caU, 0xbfd5cfd3U,
     0x3fec0376U},
    {0x4116f605U, 0x80000001U, 0xe59af060U, 0x3f3172e9U, 0x3f8cf091U, 0xbea3c581U, 0x3ee37735U, 0xbf9c3380U,
     0xbf2d4ed5U},
    {0x40000000U, 0xbf208658U, 0x807fffffU, 0xbe97e96dU, 0x188809e7U, 0x3eef1101U, 0xbd28f794U, 0x3f9508b5U,
     0x00000000U},
    {0x3fd705e2U, 0x54c9533eU, 0x3f41e5fcU, 0xdf8ab10eU, 0x80000001U, 0xeb2931caU, 0x40400000U, 0x007fffffU,
     0x3f3d2026U},
    {0xf60c9f22U, 0xbd29d50fU, 0xb9447473U, 0xbf8a6ec8U, 0x40ad1fd4U, 0xbdf7bc86U, 0x696cd03eU, 0x81330e53U,
     0x00000001U},
    {0x007fef3cU, 0xbe2ecf4dU, 0x9d797f40U, 0xc0000000U, 0x40b425f5U, 0xc0000000U, 0x3ec33228U, 0x653fad3dU,
     0x00000000U},
    {0x40782bfaU, 0x3f86ad52U, 0xbf33cb47U, 0xbf800000U, 0xc6000001U, 0xbeab9dd1U, 0x3dc3a6caU, 0x3f8c365bU,
     0x3f0d950eU},
    {0x40e51c9eU, 0x3f20759dU, 0xbe9f7925U, 0xbe73c7aaU, 0x416ec4ccU, 0x3f22bfd1U, 0x3f0b65c2U, 0xbf226f6bU,
     0xe57c55bbU},
};

// the reference's outputs, as bits, step by step
static const uint32_t figure7_recorded_outputs[24][figure7_noutput] = {
    {0x3f173606U, 0xc0dd1ea8U, 0x3f847f8eU},
    {0xbe018689U, 0xbecad126U, 0xbf49e5d0U},
    {0x3ede94e2U, 0xc112d1eeU, 0xbf04e2d0U},
    {0x3f3abdf3U, 0xc0f821d2U, 0x3f7e0a5aU},
    {0x3e9e9013U, 0xc0a56e0aU, 0x3e11e9a4U},
    {0x3e908bd0U, 0xbda62f7eU, 0x3f8d7adcU},
    {0x3ebf3f86U, 0xbd900986U, 0x3f46cb3eU},
    {0x3de03014U, 0xbfd972b5U, 0xbebf175cU},
    {0x3c8a1102U, 0xc09327b6U, 0xbe438880U},
    {0x3dfafad3U, 0xc10c28a6U, 0xbf4dcfbdU},
    {0xbf330d24U, 0xbe4f596eU, 0xbf8c935dU},
    {0x3f0c29c1U, 0xc1103683U, 0xbf26e61aU},
    {0xbf0e0a04U, 0x269afd12U, 0x41bf0551U},
    {0x3f0839b0U, 0xc0e473b8U, 0xbf83282aU},
    {0xd01ed1e3U, 0x53be4facU, 0xd127222cU},
    {0xbf9b22cfU, 0xc0032b80U, 0xbf837c5eU},
    {0x3fa05a0dU, 0x3f800000U, 0xf8425451U},
    {0x64035f77U, 0x7f800000U, 0x659af060U},
    {0xbd28f794U, 0xc0000000U, 0x007fffffU},
    {0xdf8ab10eU, 0xa963e17eU, 0x41cdb446U},
    {0x696cd03eU, 0x6588f7ccU, 0x39447473U},
    {0x5c799ff2U, 0x1e0b4beeU, 0x1d797f40U},
    {0xbf51a237U, 0xc0928f66U, 0xc8043671U},
    {0xbe473b96U, 0xc0ef1430U, 0x00000000U},
};

// outputs that try the output stage, as bits, step by step
static const uint32_t figure7_recorded_values[24][figure7_noutput] = {
    {0x19d688fcU, 0xff800000U, 0x46000000U},
    {0xbfb247b5U, 0xc28ac66bU, 0x428a770bU},
    {0xc270b28eU, 0xc22c2d78U, 0x4266570fU},
    {0xc274259dU, 0xc22b9c4bU, 0x426a093eU},
    {0x408910a9U, 0x97c5608eU, 0xbf800000U},
    {0x41111f95U, 0x3faeaf94U, 0x3fe32450U},
    {0x4b000000U, 0x424b752fU, 0x4231260fU},
    {0x4272df72U, 0x42453f76U, 0x422adedbU},
    {0x4214e28eU, 0xb2f18d97U, 0x3f7fffffU},
    {0x41fecd58U, 0xbf8e5846U, 0xbe6f3b22U},
    {0xc2136741U, 0xc20c6337U, 0xc1ee1fa0U},
    {0xc20dac31U, 0xc215518aU, 0xc201da4fU},
    {0x412d5ae3U, 0xc25554d1U, 0xc212a657U},
    {0x4114df48U, 0xc263d4cbU, 0xc2013104U},
    {0xfc4577d6U, 0xc21f7765U, 0xff800000U},
    {0xc280cb10U, 0xc22be5e4U, 0xc2760a21U},
    {0x4221c718U, 0xc2169327U, 0xc133383cU},
    {0x420c4f2cU, 0xc213153aU, 0xc127f107U},
    {0xbf800000U, 0xc10039e5U, 0x4208f9c2U},
    {0xc0c5398eU, 0xc1513bcdU, 0x42151b5fU},
    {0xecd347acU, 0x4021ff83U, 0xc2256f1bU},
    {0xc27865b1U, 0x40f2094eU, 0xc234b360U},
    {0x40eac3dfU, 0xf64f9e16U, 0x02381a7fU},
    {0x40a2beabU, 0xc280138bU, 0x40ac51d4U},
};

// the reference's commands for them, as bits, step by step
static const uint32_t figure7_recorded_commands[24][figure7_noutput] = {
    {0x16efa354U, 0xbf92c674U, 0x3f92c674U},
    {0xbcc7240bU, 0xbf92c674U, 0x3f92c674U},
    {0xbf866e4bU, 0xbf405301U, 0x3f80a56bU},
    {0xbf879ae8U, 0xbf3fb0d8U, 0x3f82b5deU},
    {0x3d991a69U, 0x94dc78f0U, 0xbc8efa35U},
    {0x3e221ab7U, 0x3cc3203fU, 0x3cfdb84aU},
    {0x3f879ae8U, 0x3f6343b5U, 0x3f45e080U},
    {0x3f879ae8U, 0x3f5c53f9U, 0x3f3edd3dU},
    {0x3f264e5eU, 0xb006e8a0U, 0x3c8efa34U},
    {0x3f0e4ef0U, 0xbc9f002dU, 0xbb859c9eU},
    {0xbf24a6afU, 0xbf1cd07dU, 0xbf04fe47U},
    {0xbf1e3ff5U, 0xbf26ca56U, 0xbf110c04U},
    {0x3e41a3b1U, 0xbf6e4b1aU, 0xbf23cf32U},
    {0x3e264ab6U, 0xbf7e7d6bU, 0xbf104eeaU},
    {0xbf879ae8U, 0xbf32202bU, 0xbf92c674U},
    {0xbf879ae8U, 0xbf40030dU, 0xbf896a17U},
    {0x3f34b51aU, 0xbf283195U, 0xbe4830b7U},
    {0x3f1cba1aU, 0xbf244b0fU, 0xbe3b97acU},
    {0xbc8efa35U, 0xbe0f3ae0U, 0x3f1900d4U},
    {0xbddc4d60U, 0xbe69b757U, 0x3f268dd5U},
    {0xbf879ae8U, 0x3d34f41fU, 0xbf38caa3U},
    {0xbf879ae8U, 0x3e072db8U, 0xbf49d838U},
    {0x3e031e1aU, 0xbf92c674U, 0x0019b4a9U},
    {0x3db5c9a5U, 0xbf8f1009U, 0x3dc07b9eU},
};

// the reference's outputs in a closed loop, as bits, step by step
static const uint32_t figure7_recorded_loop[32][figure7_noutput] = {
    {0x3f173606U, 0xc0dd1ea8U, 0x3f847f8eU},
    {0x3efa1cc0U, 0xc0a5c71aU, 0x3f459754U},
    {0x3ed2817cU, 0xc0789666U, 0x3f1354c9U},
    {0x3eb47aefU, 0xc03a650dU, 0x3edbb60aU},
    {0x3e9dade4U, 0xc00bc650U, 0x3ea3d31cU},
    {0x3e8c5306U, 0xbfd1a7c0U, 0x3e744eadU},
    {0x3e7e24f4U, 0xbf9d42e3U, 0x3e362a1dU},
    {0x3e69d0b3U, 0xbf6bf86eU, 0x3e07d41bU},
    {0x3e5a1fe7U, 0xbf3115afU, 0x3dca8eb7U},
    {0x3e4de81eU, 0xbb8dda70U, 0x3d9708c7U},
    {0x3e444617U, 0xbb6e67a9U, 0x3d613bc0U},
    {0x3e3c8baaU, 0xbb48797fU, 0x3d27f13aU},
    {0x3e363203U, 0xbb29219eU, 0x3cfa72a7U},
    {0x3e30cf2bU, 0xbb0f84feU, 0x3cbabe3cU},
    {0x3e2c0dfbU, 0xbaf596dbU, 0x3c8b3e15U},
    {0x3e27a80aU, 0xbad4565bU, 0x3c4fa60eU},
    {0x3e23612cU, 0xbab9dccbU, 0x3c1ad498U},
    {0x3e1f0464U, 0xbaa4e9dfU, 0x3be6e4ffU},
    {0x3e1a6228U, 0xba9467c0U, 0x3bac29d6U},
    {0x3e155038U, 0xba8767cfU, 0x3b805f12U},
    {0x3e0faae6U, 0xba7a3c65U, 0x3b3f6fd2U},
    {0x3e0957e6U, 0xba69bb07U, 0x3b0ebe07U},
    {0x3e0249f8U, 0xba5c2613U, 0x3ad4de27U},
    {0x3df5092cU, 0xba5087ccU, 0x3a9eb8d7U},
    {0x3de43bf3U, 0xba4616c8U, 0x3a6cb2acU},
    {0x3dd27ca6U, 0xba3c342fU, 0x3a307d9cU},
    {0x3dc036d1U, 0xba326abaU, 0x3a039911U},
    {0x3dade2dbU, 0xba286d28U, 0x39c43f9cU},
    {0x3d9bf5feU, 0xba1e12f4U, 0x3992547fU},
    {0x3d8ad4aeU, 0xba135317U, 0x395a37d7U},
    {0x3d7594b7U, 0xba083d1dU, 0x3922b621U},
    {0x3d580e57U, 0xb9f9e30dU, 0x38f2a5b2U},
};

static float figure7_float(uint32_t bits) {
  union {
    uint32_t u;
    float f;
  } word;
  // volatile: the check must run on the machine, not in the compiler
  volatile uint32_t unknown = bits;
  word.u = unknown;
  return word.f;
}

// same bits; all NaNs are equal
static int32_t figure7_same(float value, uint32_t bits) {
  union {
    uint32_t u;
    float f;
  } word;
  word.f = value;
  if (value != value) {
    return bits == 0x7fc00000U;
  }
  return word.u == bits;
}

static int32_t figure7_arithmetic(void) {
  const float smallest_normal = figure7_float(0x00800000U);
  const float half = figure7_float(0x3f000000U);
  const float one = figure7_float(0x3f800000U);
  const float factor = figure7_float(0x3f800800U);  // 1 + 2^-12
  const float square = figure7_float(0xbf801000U);  // -(1 + 2^-11), that squared and rounded, negated
  const float half_unit = figure7_float(0x33800000U);  // 2^-24, half a unit in the last place of 1
  const float three_halves = figure7_float(0x34400000U);  // 3 * 2^-24, one and a half units of 1
  float y;
  y = smallest_normal * half;
  if (!figure7_same(y, 0x00400000U)) {
    return -1;
  }
  y = figure7_float(0x00400000U);
  y = y / half;
  if (!figure7_same(y, 0x00800000U)) {
    return -1;
  }
  y = one + half_unit;
  if (!figure7_same(y, 0x3f800000U)) {
    return -3;
  }
  y = one + three_halves;
  if (!figure7_same(y, 0x3f800002U)) {
    return -3;
  }
  y = factor * factor;
  y = y + square;
  return figure7_same(y, 0x00000000U) ? 0 : -2;
}

static int32_t figure7_clamps(uint32_t bits, const float expected[figure7_noutput]) {
  float outputs[figure7_noutput];
  int32_t i;
  for (i = 0; i < figure7_noutput; i++) {
    outputs[i] = figure7_float(bits);
  }
  figure7_clamp(outputs);
  for (i = 0; i < figure7_noutput; i++) {
    if (!(outputs[i] == expected[i])) {
      return 0;
    }
  }
  return 1;
}

static int32_t figure7_clamp_check(void) {
  static const float low[figure7_noutput] = {(-60.7000008F), (-65.6999969F), (-65.6999969F)};
  static const float high[figure7_noutput] = {60.7000008F, 65.6999969F, 65.6999969F};
  static const float neutral[figure7_noutput] = {0.0F, 0.0F, 0.0F};
  return figure7_clamps(0xff800000U, low) && figure7_clamps(0x7f800000U, high) &&
         figure7_clamps(0x7fc00000U, neutral);
}

static int32_t figure7_command_check(void) {
  figure7_state state;
  float values[figure7_noutput];
  float command[figure7_noutput];
  int32_t step;
  int32_t i;
  figure7_init(&state);
  for (step = 0; step < 24; step++) {
    for (i = 0; i < figure7_noutput; i++) {
      values[i] = figure7_float(figure7_recorded_values[step][i]);
    }
    figure7_command(&state, values, command);
    for (i = 0; i < figure7_noutput; i++) {
      if (!figure7_same(command[i], figure7_recorded_commands[step][i])) {
        return 0;
      }
    }
  }
  return 1;
}

static void figure7_feed_back(const float command[figure7_noutput], float inputs[figure7_ninput]) {
  static const float low[figure7_ninput] = {0.0F, (-1.05999994F), (-1.14699996F), (-1.14699996F), 0.0F, (-1.0F), 0.0F, (-2.0F), (-2.0F)};
  static const float high[figure7_ninput] = {10.0F, 1.05999994F, 1.14699996F, 1.14699996F, 30.0F, 1.0F, 0.600000024F, 2.0F, 2.0F};
  int32_t i;
  for (i = 0; i < figure7_ninput; i++) {
    float y = command[i % figure7_noutput];
    y = y - inputs[i];
    y = 0.25F * y;
    y = inputs[i] + y;
    inputs[i] = figure7_limit(y, low[i], high[i], low[i]);
  }
}

// from the first recorded inputs on, every input goes towards a command, within its range
static int32_t figure7_closed_loop(void) {
  figure7_state state;
  float inputs[figure7_ninput];
  float outputs[figure7_noutput];
  float command[figure7_noutput];
  int32_t step;
  int32_t i;
  figure7_init(&state);
  for (i = 0; i < figure7_ninput; i++) {
    inputs[i] = figure7_float(figure7_recorded_inputs[0][i]);
  }
  for (step = 0; step < 32; step++) {
    figure7_step(&state, inputs, outputs);
    figure7_command(&state, outputs, command);
    figure7_feed_back(command, inputs);
    for (i = 0; i < figure7_noutput; i++) {
      if (!figure7_same(outputs[i], figure7_recorded_loop[step][i])) {
        return 0;
      }
    }
  }
  return 1;
}

int32_t figure7_selftest(void) {
  figure7_state state;
  float inputs[figure7_ninput];
  float outputs[figure7_noutput];
  int32_t step;
  int32_t i;
  const int32_t status = figure7_arithmetic();
  if (status != 0) {
    return status;
  }
  figure7_init(&state);
  for (step = 0; step < 24; step++) {
    if (step == 12) {
      figure7_init(&state);
    }
    for (i = 0; i < figure7_ninput; i++) {
      inputs[i] = figure7_float(figure7_recorded_inputs[step][i]);
    }
    figure7_step(&state, inputs, outputs);
    for (i = 0; i < figure7_noutput; i++) {
      if (!figure7_same(outputs[i], figure7_recorded_outputs[step][i])) {
        return step + 1;
      }
    }
  }
  if (!figure7_clamp_check()) {
    return -4;
  }
  if (!figure7_command_check()) {
    return -6;
  }
  return figure7_closed_loop() ? 0 : -7;
}
