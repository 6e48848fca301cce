// Formatting of numbers by the rules of peernet_statistics::number. daemon/statistics/tests/numbers.json has test cases for both.
const NUMBERS = (() => {
  const NONE = "—", MINUS = "\u2212";
  // Numbers from this size on are written with a power of ten.
  const HUGE = 1e12;

  // Formats a number with a fixed number of decimals, a true minus sign, and commas between thousands. A number that is
  // rounded to zero has no sign.
  function fixed(value, decimals) {
    if (value == null || !Number.isFinite(value)) return NONE;
    const size = Math.abs(value);
    if (size >= HUGE) return (value < 0 ? MINUS : "") + size.toExponential(3).replace("e+", "e");
    const digits = size.toFixed(decimals), sign = value < 0 && /[1-9]/.test(digits) ? MINUS : "";
    const [whole, fraction] = digits.split(".");
    return sign + group(whole) + (fraction ? `.${fraction}` : "");
  }
  const group = (digits) => digits.replace(/\B(?=(\d{3})+$)/g, ",");

  // Returns the number of decimals that show `digits` significant digits. The exponent is that of the rounded value,
  // because rounding may add a digit before the decimal point (9.996 becomes 10.0).
  function decimals(value, digits) {
    if (!value || !Number.isFinite(value)) return digits - 1;
    return Math.max(0, digits - 1 - Number(value.toExponential(digits - 1).split("e")[1]));
  }

  return {
    fixed,
    // Milliseconds with three significant digits, but without digits below a nanosecond.
    milliseconds: (value) => fixed(value, Math.abs(value) < 1e-6 ? 2 : Math.min(6, decimals(value, 3))),
    // Megabytes per second with three significant digits, but without digits below a byte per second.
    throughput: (value) => (value === 0 ? "0" : fixed(value, Math.min(6, decimals(value, 3)))),
    count: (value) => group(String(value)),
    // Label of an axis. Its value is round, so trailing zeros are removed.
    tick: (value) => {
      const text = fixed(+value.toPrecision(3), 6);
      return text.includes("e") ? text : text.replace(/\.?0+$/, "");
    },
  };
})();
