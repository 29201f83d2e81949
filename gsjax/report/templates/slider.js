// A slider over a pair of pictures says how much of the photo is seen.
document.addEventListener("input", (event) => {
  const pair = event.target.closest(".pair");
  if (pair) pair.style.setProperty("--at", event.target.value + "%");
});
