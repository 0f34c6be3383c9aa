// What the page uses of uPlot.
export { default } from "uplot";
