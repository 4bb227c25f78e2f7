// A slider that wipes from one picture to the other. The range input covers the pictures, so that dragging anywhere and
// the arrow keys do the same; --at is where the line stands.

export function wipe(field: HTMLElement): { set: (percent: number) => void } {
  const range = field.querySelector<HTMLInputElement>(".wipe-range")!;
  const show = () => {
    field.style.setProperty("--at", `${range.value}%`);
    range.setAttribute("aria-valuetext", `${range.value} % photo, ${100 - Number(range.value)} % head`);
  };
  range.addEventListener("input", show);
  show();
  return {
    set: (percent) => {
      range.value = String(percent);
      show();
    },
  };
}
