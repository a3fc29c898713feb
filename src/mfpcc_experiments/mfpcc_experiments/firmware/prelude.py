"""What kernels use of Python that C does not have: small functions, as numba computes them."""

from __future__ import annotations

# Of each: what it gives, its parameters, what it does. `R` is the type of a real number.
_HELPERS = {
    "complex_of": (
        "mfpcc_complex",
        "R re, R im",
        "const mfpcc_complex z = {re, im};\n    return z;",
    ),
    "complex_add": (
        "mfpcc_complex",
        "mfpcc_complex u, mfpcc_complex v",
        "const mfpcc_complex z = {u.re + v.re, u.im + v.im};\n    return z;",
    ),
    "complex_sub": (
        "mfpcc_complex",
        "mfpcc_complex u, mfpcc_complex v",
        "const mfpcc_complex z = {u.re - v.re, u.im - v.im};\n    return z;",
    ),
    "complex_mul": (
        "mfpcc_complex",
        "mfpcc_complex u, mfpcc_complex v",
        "const mfpcc_complex z = {u.re * v.re - u.im * v.im, u.re * v.im + u.im * v.re};\n"
        "    return z;",
    ),
    "complex_neg": (
        "mfpcc_complex",
        "mfpcc_complex u",
        "const mfpcc_complex z = {-u.re, -u.im};\n    return z;",
    ),
    "complex_conj": (
        "mfpcc_complex",
        "mfpcc_complex u",
        "const mfpcc_complex z = {u.re, -u.im};\n    return z;",
    ),
    "complex_abs": ("R", "mfpcc_complex u", "return HYPOT(u.re, u.im);"),
    "real_min": ("R", "R x, R y", "return y < x ? y : x;"),
    "real_max": ("R", "R x, R y", "return y > x ? y : x;"),
    "real_square": ("R", "R x", "return x * x;"),
    "real_remainder": (
        "R",
        "R x, R y",
        "R rest = FMOD(x, y);\n"
        "    if (rest == ZERO) {\n"
        "        rest = COPYSIGN(ZERO, y);\n"
        "    } else if ((y < ZERO) != (rest < ZERO)) {\n"
        "        rest += y;\n"
        "    }\n"
        "    return rest;",
    ),
    "real_frexp": (
        "TUPLE",
        "R x",
        "int exponent;\n"
        "    const R mantissa = FREXP(x, &exponent);\n"
        "    const TUPLE both = {mantissa, exponent};\n"
        "    return both;",
    ),
    "int_quotient": (
        "int64_t",
        "int64_t x, int64_t y",
        "const int64_t quotient = x / y;\n"
        "    return (x % y != 0 && (x < 0) != (y < 0)) ? quotient - 1 : quotient;",
    ),
    "int_remainder": (
        "int64_t",
        "int64_t x, int64_t y",
        "const int64_t rest = x % y;\n"
        "    return (rest != 0 && (rest < 0) != (y < 0)) ? rest + y : rest;",
    ),
}

_SAYS = {
    "real_min": "As Python's: what is no number does not replace the first.",
    "real_max": "As Python's: what is no number does not replace the first.",
    "real_remainder": "With the sign of the divisor, as Python's.",
    "int_quotient": "Rounded down, as Python's.",
    "int_remainder": "With the sign of the divisor, as Python's.",
}


def helper(name: str, text: str, real: str, hypot: str) -> str:
    """
    A function of the prelude in C.

    Parameters
    ----------
    name : str
        Which.
    text : str
        How it is called in the program.
    real : str
        `double` or `float`.
    hypot : str
        The function that gives the length of a complex number.
    """
    result, parameters, body = _HELPERS[name]
    single = real == "float"
    pair = "tuple_real_1_int32_1" if text == name else f"tuple_real_1_int32_1_{real}"
    code = f"static inline {result} {text}({parameters})\n{{\n    {body}\n}}"
    for word, by in (
        ("HYPOT", hypot),
        ("FMOD", "fmodf" if single else "fmod"),
        ("COPYSIGN", "copysignf" if single else "copysign"),
        ("FREXP", "frexpf" if single else "frexp"),
        ("ZERO", "0.0f" if single else "0.0"),
        ("TUPLE", pair),
    ):
        code = code.replace(word, by)
    code = (
        code.replace("(R ", f"({real} ")
        .replace(" R ", f" {real} ")
        .replace("    R ", f"    {real} ")
    )
    return f"/* {_SAYS[name]} */\n{code}" if name in _SAYS else code
