// Numbers as people read them, by the rules of peernet_statistics::number; daemon/statistics/tests/numbers.json has cases for both.
const NUMBERS = (() => {
  const NONE = "—", MINUS = "\u2212";
  // From this on a number is written with its power of ten.
  const HUGE = 1e12;

  // With a fixed count of decimals: a true minus sign, thousands with commas, no signed zero.
  function fixed(value, decimals) {
    if (value == null || !Number.isFinite(value)) return NONE;
    const size = Math.abs(value);
    if (size >= HUGE) return (value < 0 ? MINUS : "") + size.toExponential(3).replace("e+", "e");
    const digits = size.toFixed(decimals), sign = value < 0 && /[1-9]/.test(digits) ? MINUS : "";
    const [whole, fraction] = digits.split(".");
    return sign + group(whole) + (fraction ? `.${fraction}` : "");
  }
  const group = (digits) => digits.replace(/\B(?=(\d{3})+$)/g, ",");

  // How many decimals show so many significant digits; rounded first, because that may carry into the next place.
  function decimals(value, digits) {
    if (!value || !Number.isFinite(value)) return digits - 1;
    return Math.max(0, digits - 1 - Number(value.toExponential(digits - 1).split("e")[1]));
  }

  return {
    fixed,
    // Three significant digits, however small.
    significant: (value) => fixed(value, decimals(value, 3)),
    // The same with at most two decimals, for sentences and figures.
    figure: (value) => fixed(value, Math.min(2, decimals(value, 3))),
    count: (value) => group(String(value)),
    // A label of an axis: round by construction, so that zeros at its end are left out.
    tick: (value) => {
      const text = fixed(+value.toPrecision(3), 6);
      return text.includes("e") ? text : text.replace(/\.?0+$/, "");
    },
  };
})();
